// The shaders: one vertex shader, the surface, the background, and the pick pass.

export const MODES = ['final', 'albedo', 'roughness', 'irradiance', 'radiance', 'emission', 'confidence', 'roughness-confidence', 'labels', 'rooms', 'error'];

export const MAX_PROBES = 8;
export const MAX_LAMPS = 16;

export const surfaceVertex = `
layout(location = 0) in vec3 a_position;
layout(location = 1) in vec2 a_uv;
layout(location = 2) in vec3 a_normal;
layout(location = 3) in uint a_lamp;
uniform mat4 u_clip_from_world;
out vec3 v_position;
out vec2 v_uv;
out vec3 v_normal;
flat out uint v_lamp;
void main() {
  v_position = a_position;
  v_uv = a_uv;
  v_normal = a_normal;
  v_lamp = a_lamp;
  gl_Position = u_clip_from_world * vec4(a_position, 1.0);
}`;

export const backgroundVertex = `
uniform mat4 u_world_from_clip;
out vec3 v_far;
void main() {
  vec2 p = vec2((gl_VertexID & 1) * 4 - 1, (gl_VertexID >> 1) * 4 - 1);
  vec4 far = u_world_from_clip * vec4(p, 1.0, 1.0);
  v_far = far.xyz / far.w;
  gl_Position = vec4(p, 1.0, 1.0);
}`;

// Shared by surface and background. All radiometric textures hold radiance times the scene's base exposure.
const common = `
uniform int u_mode;
uniform float u_exposure;
uniform bool u_soft;
uniform vec3 u_eye;
uniform float u_split;
uniform bool u_has_photo;
uniform vec3 u_photo_eye;
uniform mat3 u_camera_from_world;
uniform sampler2D u_photo;
const float PI = 3.14159265359;

// Column and row of a direction on a panorama (x right, y up, looking down -z).
vec2 panorama(vec3 d) {
  d = normalize(d);
  return vec2(atan(d.x, -d.z) / (2.0 * PI) + 0.5, acos(clamp(d.y, -1.0, 1.0)) / PI);
}
vec3 srgb(vec3 x) {
  x = clamp(x, 0.0, 1.0);
  return mix(12.92 * x, 1.055 * pow(x, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, x));
}
vec3 display(vec3 radiance) {
  vec3 x = max(radiance, 0.0) * u_exposure;
  return srgb(u_soft ? 1.0 - exp(-x) : x);
}
// Black, violet, red, orange, pale yellow.
vec3 heat(float t) {
  t = clamp(t, 0.0, 1.0) * 4.0;
  vec3 a = mix(vec3(0.0, 0.0, 0.02), vec3(0.34, 0.06, 0.43), clamp(t, 0.0, 1.0));
  a = mix(a, vec3(0.73, 0.21, 0.33), clamp(t - 1.0, 0.0, 1.0));
  a = mix(a, vec3(0.98, 0.55, 0.04), clamp(t - 2.0, 0.0, 1.0));
  return mix(a, vec3(0.99, 1.0, 0.64), clamp(t - 3.0, 0.0, 1.0));
}
vec3 photograph(vec3 towards) {
  return textureLod(u_photo, panorama(u_camera_from_world * (towards - u_photo_eye)), 0.0).rgb;
}
bool left_of_split() { return u_has_photo && gl_FragCoord.x < u_split; }
vec3 error_colour(vec3 shown, vec3 truth) {
  vec3 d = abs(display(shown) - display(truth));
  return heat((d.r + d.g + d.b) / 3.0 / 0.25);
}`;

export const surfaceFragment = common + `
in vec3 v_position;
in vec2 v_uv;
in vec3 v_normal;
flat in uint v_lamp;
uniform sampler2D u_albedo;
uniform sampler2D u_roughness;
uniform sampler2D u_irradiance;
uniform sampler2D u_radiance;
uniform sampler2D u_emission;
uniform sampler2D u_confidence;
uniform highp usampler2D u_ids;
uniform highp sampler2D u_edits;
uniform sampler2D u_light;
uniform highp sampler2DArray u_probe_radiance;
uniform highp sampler2DArray u_probe_distance;
uniform int u_probe_count;
uniform vec4 u_probes[${MAX_PROBES}];
uniform float u_probe_levels;
uniform bool u_probes_relit;
uniform vec3 u_lamp_gain[${MAX_LAMPS}];
uniform int u_marked;
out vec4 colour;

// A distinct colour for an id: hues a golden angle apart.
vec3 id_colour(uint id) {
  if (id == 0u) return vec3(0.35);
  float h = fract(float(id) * 0.618034);
  float v = 0.72 + 0.24 * fract(float(id) * 0.41421);
  vec3 rgb = clamp(abs(fract(h + vec3(0.0, 2.0, 1.0) / 3.0) * 6.0 - 3.0) - 1.0, 0.0, 1.0);
  return mix(vec3(v), rgb * v, 0.62);
}

// Radiance arriving along r at p: the nearest probe of the room, moved to where p sees it.
vec3 reflected(vec3 p, vec3 r, float roughness, uint room) {
  int best = -1;
  float least = 1e30;
  for (int i = 0; i < u_probe_count; i++) {
    float d = distance(p, u_probes[i].xyz) + (uint(u_probes[i].w) == room ? 0.0 : 1e9);
    if (d < least) { least = d; best = i; }
  }
  if (best < 0) return vec3(0.0);
  vec3 o = p - u_probes[best].xyz;
  vec3 d = r;
  for (int i = 0; i < 3; i++) {
    float reach = textureLod(u_probe_distance, vec3(panorama(d), float(best)), 0.0).r;
    // the sky is far
    if (reach <= 0.0) reach = 1e4;
    float b = dot(o, r);
    float t = -b + sqrt(max(b * b - dot(o, o) + reach * reach, 0.0));
    d = o + r * max(t, 1e-3);
  }
  return textureLod(u_probe_radiance, vec3(panorama(d), float(best)), roughness * (u_probe_levels - 1.0)).rgb;
}

void main() {
  vec3 to_eye = normalize(u_eye - v_position);
  vec3 n = normalize(v_normal);
  if (dot(n, to_eye) < 0.0) n = -n;
  float facing = clamp(dot(n, to_eye), 0.0, 1.0);
  uvec2 ids = texelFetch(u_ids, clamp(ivec2(v_uv * vec2(textureSize(u_ids, 0))), ivec2(0), textureSize(u_ids, 0) - 1), 0).rg;
  vec4 edit = texelFetch(u_edits, ivec2(ids.r & 255u, ids.r >> 8), 0);
  vec4 base = texture(u_albedo, v_uv);
  vec3 albedo = clamp(base.rgb * edit.rgb, 0.0, 1.0);
  float metal = 1.0 - base.a;
  float roughness = clamp(texture(u_roughness, v_uv).r + edit.a, 0.0, 1.0);
  // the ratio of changed to reconstructed light
  vec3 light = texture(u_light, v_uv).rgb;
  vec3 irradiance = texture(u_irradiance, v_uv).rgb * light;
  vec3 emission = texture(u_emission, v_uv).rgb;
  // bilinear fringes around a lamp are not light
  emission = v_lamp > 0u ? emission * u_lamp_gain[int(v_lamp)] : vec3(0.0);

  vec3 shown = vec3(0.0);
  bool lit = u_mode == 0 || u_mode == 10;
  if (lit) {
    // Fresnel as in the method; roughness weakens its rise towards grazing view
    float grazing = exp2((-5.55473 * facing - 6.98316) * facing);
    vec3 f0 = mix(vec3(0.04), albedo, metal);
    vec3 fresnel = f0 + (max(vec3(1.0 - roughness), f0) - f0) * grazing;
    vec3 mirror = reflect(-to_eye, n);
    // a wide lobe shows the mean light around (from R = 0.6 on, as in src/specular/directional_albedo.rs)
    vec3 seen = reflected(v_position, mirror, roughness, ids.g) * (u_probes_relit ? vec3(1.0) : light);
    vec3 specular = fresnel * mix(seen, irradiance / PI, smoothstep(0.3, 0.6, roughness));
    shown = dot(emission, vec3(1.0)) > 0.0 ? emission : albedo * (1.0 - metal) * irradiance / PI + specular;
  }
  if (u_mode == 10) {
    colour = vec4(u_has_photo ? error_colour(shown, photograph(v_position)) : display(shown), 1.0);
    if (left_of_split()) colour = vec4(display(photograph(v_position)), 1.0);
    return;
  }
  float shade = 0.62 + 0.38 * facing;
  vec3 value;
  if (u_mode == 0) value = display(shown);
  else if (u_mode == 1) value = srgb(albedo);
  else if (u_mode == 2) value = vec3(roughness);
  else if (u_mode == 3) value = display(irradiance / PI);
  else if (u_mode == 4) value = display(texture(u_radiance, v_uv).rgb);
  else if (u_mode == 5) value = display(emission);
  else if (u_mode == 6 || u_mode == 7) {
    vec2 codes = texture(u_confidence, v_uv).rg * 255.0;
    float code = u_mode == 6 ? codes.r : codes.g;
    // 10^-4 to 10 stored; 10^-3 to 1 shown
    value = code > 254.5 ? vec3(0.5) * shade : heat((code / 254.0 * 5.0 - 1.0) / 3.0);
  } else if (u_mode == 8) value = id_colour(ids.r) * shade;
  else value = id_colour(ids.g) * shade;
  if (u_marked >= 0 && int(ids.r) == u_marked) {
    float stripe = step(0.5, fract((gl_FragCoord.x + gl_FragCoord.y) / 14.0));
    value = mix(value, vec3(1.0, 0.55, 0.2), 0.18 + 0.14 * stripe);
  }
  colour = vec4(left_of_split() ? display(photograph(v_position)) : value, 1.0);
}`;

export const backgroundFragment = common + `
in vec3 v_far;
uniform sampler2D u_environment;
uniform vec3 u_outside;
uniform vec3 u_backdrop;
out vec4 colour;
void main() {
  vec3 sky = textureLod(u_environment, panorama(v_far - u_eye), 0.0).rgb * u_outside;
  bool lit = u_mode == 0 || u_mode == 4 || u_mode == 10;
  vec3 value = lit ? display(sky) : u_backdrop;
  if (u_mode == 10 && u_has_photo) value = error_colour(sky, photograph(v_far));
  colour = vec4(left_of_split() ? display(photograph(v_far)) : value, 1.0);
}`;

// Atlas coordinate and distance, bit for bit; alpha 1 marks a hit.
export const pickFragment = `
in vec3 v_position;
in vec2 v_uv;
in vec3 v_normal;
flat in uint v_lamp;
uniform vec3 u_eye;
out uvec4 hit;
void main() {
  hit = uvec4(floatBitsToUint(v_uv.x), floatBitsToUint(v_uv.y), floatBitsToUint(distance(u_eye, v_position)), 1u + v_lamp);
}`;
