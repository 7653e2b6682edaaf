// The shaders: one vertex shader, the surface, the background, the mean of samples, and the pick pass.

import { tracing } from './tracing.js';

export const MODES = ['final', 'albedo', 'roughness', 'irradiance', 'radiance', 'emission', 'confidence', 'roughness-confidence', 'labels', 'rooms', 'error'];

export const MAX_PROBES = 8;
export const MAX_LAMPS = 16;
// Panes that a reflection goes through.
const MOST_SHEETS = 8;

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
invariant gl_Position;
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
// Number of the sample that is added up; -1 where the screen is drawn to.
uniform int u_sample;
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
// As the screen shows radiance; while samples are added up it stays what it is, up to what 64 of them can be added to.
vec3 display(vec3 radiance) {
  if (u_sample >= 0) return clamp(radiance, 0.0, 1000.0);
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

// What surfaces are made of, as it is edited.
const materials = `
uniform sampler2D u_albedo;
uniform sampler2D u_roughness;
uniform sampler2D u_irradiance;
uniform sampler2D u_emission;
uniform highp usampler2D u_ids;
uniform highp sampler2D u_edits;
uniform vec3 u_lamp_gain[${MAX_LAMPS}];
uniform float u_least_distance;

// 'clear' is the share of light that goes through.
struct Surface { vec3 colour; float metal; float clear; float roughness; vec3 irradiance; vec3 emission; };

uvec2 ids_at(vec2 uv) {
  ivec2 size = textureSize(u_ids, 0);
  return texelFetch(u_ids, clamp(ivec2(uv * vec2(size)), ivec2(0), size - 1), 0).rg;
}
// 'light' is the ratio of changed to reconstructed irradiance. Bilinear fringes around a lamp are no light.
Surface edited(vec4 base, vec2 sheet, vec3 irradiance, vec3 light, vec3 emission, uint label, uint lamp) {
  vec4 edit = texelFetch(u_edits, ivec2(label & 255u, label >> 8), 0);
  return Surface(clamp(base.rgb * edit.rgb, 0.0, 1.0), 1.0 - base.a, sheet.g, clamp(sheet.r + edit.a, 0.0, 1.0), irradiance * light,
    lamp > 0u ? emission * u_lamp_gain[int(lamp)] : vec3(0.0));
}
vec3 diffuse(Surface s) { return s.colour * (1.0 - s.metal) * (1.0 - s.clear); }
// The chance that light goes straight through, as in src/render/panes.rs.
float passing(Surface s, float cosine) {
  float mean = dot(s.colour, vec3(1.0 / 3.0)) * (1.0 - s.metal);
  return s.clear * mean * 0.96 * (1.0 - pow(1.0 - cosine, 5.0));
}
uint scrambled(uint x) {
  uint s = x * 747796405u + 2891336453u;
  uint w = ((s >> ((s >> 28u) + 4u)) ^ s) * 277803737u;
  return (w >> 22u) ^ w;
}
uint pixel_key() { return scrambled(uint(gl_FragCoord.x) + scrambled(uint(gl_FragCoord.y))); }
float unit(uint x) { return float(x >> 8u) / 16777216.0; }
// A number in [0, 1) for this sample of this pixel and a sheet on its way: an additive recurrence over the samples, shifted by pixel and sheet.
float chance(uint sheet) { return fract(unit(scrambled(pixel_key() + scrambled(sheet))) + float(u_sample) * 0.6180339887); }`;

// With `traced`, reflections are traced for the samples that are added up. With `panes`, for the screen, it takes two passes.
export const surfaceFragment = ({ traced, panes }) => (traced ? '#define TRACED\n' : '') + (panes ? '#define PANES\n' : '') + common + materials + (traced ? tracing : '') + `
in vec3 v_position;
in vec2 v_uv;
in vec3 v_normal;
flat in uint v_lamp;
uniform sampler2D u_radiance;
uniform sampler2D u_confidence;
uniform sampler2D u_light;
uniform sampler2D u_environment;
uniform sampler2D u_response;
uniform vec3 u_outside;
uniform float u_bias;
uniform highp sampler2DArray u_probe_radiance;
uniform highp sampler2DArray u_probe_distance;
uniform int u_probe_count;
uniform vec4 u_probes[${MAX_PROBES}];
uniform float u_probe_levels;
uniform bool u_probes_relit;
uniform int u_marked;
// Of two passes the second: panes over what they are before.
uniform bool u_sheets;
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

// Specular reflection of even light: linear in the reflectance at normal incidence, 0.04 for what is no metal.
vec3 specular_response(Surface s, vec4 response) {
  vec3 f0 = mix(vec3(0.04), s.colour, s.metal);
  return response.r + (f0 - 0.04) / 0.96 * (response.g - response.r);
}
#ifdef TRACED
// Radiance that arrives at p along l, blurred for a rough surface; what is met shows the mean of the light around it in its own lobe.
vec3 arriving(vec3 p, vec3 l, float level) {
  Met met;
  Surface s;
  for (uint sheet = 1u; sheet <= ${MOST_SHEETS}u; sheet++) {
    met = trace(p, l);
    if (met.t >= FAR) return textureLod(u_environment, panorama(l), 0.0).rgb * u_outside;
    vec2 uv = met.uv;
    s = edited(textureLod(u_albedo, uv, level), textureLod(u_roughness, uv, level).rg, textureLod(u_irradiance, uv, level).rgb,
      textureLod(u_light, uv, 0.0).rgb, textureLod(u_emission, uv, 0.0).rgb, ids_at(uv).r, met.lamp);
    if (s.clear == 0.0 || chance(sheet) >= passing(s, abs(dot(met.n, l)))) break;
    p += (met.t + u_least_distance) * l;
  }
  if (dot(s.emission, vec3(1.0)) > 0.0) return s.emission;
  vec4 response = textureLod(u_response, vec2(abs(dot(met.n, l)), s.roughness), 0.0);
  return (diffuse(s) * response.b + specular_response(s, response)) * s.irradiance / PI;
}
// Two numbers in [0, 1) for this sample of this pixel: an additive recurrence, shifted by pixel (Roberts 2018).
vec2 pair() {
  uint a = pixel_key();
  vec2 shift = vec2(unit(a), unit(scrambled(a)));
  return fract(shift + float(u_sample) * vec2(0.7548776662, 0.5698402910));
}
// A direction in which the lobe reflects, by visible normals (Dupuy and Benyoub 2023).
vec3 lobe_direction(vec3 n, vec3 to_eye, float roughness) {
  float alpha = max(roughness * roughness, 1e-4);
  vec3 x = normalize(abs(n.y) < 0.9 ? cross(n, vec3(0.0, 1.0, 0.0)) : cross(n, vec3(1.0, 0.0, 0.0)));
  mat3 world_from_local = mat3(x, cross(n, x), n);
  vec3 v = to_eye * world_from_local;
  vec3 w = normalize(vec3(alpha * v.xy, max(v.z, 1e-4)));
  vec2 u = pair();
  float z = (1.0 - u.y) * (1.0 + w.z) - w.z;
  float r = sqrt(max(1.0 - z * z, 0.0));
  vec3 h = vec3(r * cos(2.0 * PI * u.x), r * sin(2.0 * PI * u.x), z) + w;
  h = normalize(world_from_local * vec3(alpha * h.xy, max(h.z, 1e-6)));
  return reflect(-to_eye, h);
}
#endif

void main() {
  vec3 to_eye = normalize(u_eye - v_position);
  vec3 n = normalize(v_normal);
  if (dot(n, to_eye) < 0.0) n = -n;
  float facing = clamp(dot(n, to_eye), 0.0, 1.0);
  uvec2 ids = ids_at(v_uv);
  vec3 light = texture(u_light, v_uv).rgb;
  Surface s = edited(texture(u_albedo, v_uv, u_bias), texture(u_roughness, v_uv, u_bias).rg, texture(u_irradiance, v_uv, u_bias).rgb, light,
    texture(u_emission, v_uv).rgb, ids.r, v_lamp);
  vec3 albedo = s.colour, irradiance = s.irradiance, emission = s.emission;
  float roughness = s.roughness;
  vec3 shown = vec3(0.0);
  // factor on what lies behind, as the screen shows it
  float through = 1.0;
  bool lit = u_mode == 0 || u_mode == 10;
#ifdef PANES
  if (u_sheets != (lit && s.clear > 0.0) || u_sheets && (u_mode == 10 || left_of_split())) discard;
  if (u_sheets) through = pow(passing(s, facing), 1.0 / 2.2);
#endif
  if (lit) {
    vec4 response = textureLod(u_response, vec2(facing, roughness), 0.0);
    // a wide lobe shows the mean light around (from R = 0.6 on, as in src/specular/directional_albedo.rs)
    vec3 seen = irradiance / PI;
#ifdef TRACED
    vec3 face = normalize(cross(dFdx(v_position), dFdy(v_position)));
    if (dot(face, to_eye) < 0.0) face = -face;
    if (roughness < 0.6) {
      vec3 l = lobe_direction(n, to_eye, roughness);
      float under = dot(l, face);
      if (under < 0.0) l -= 2.0 * under * face;
      vec3 narrow = arriving(v_position + u_least_distance * face, l, log2(1.0 + 8.0 * roughness));
      seen = mix(narrow, seen, smoothstep(0.5, 0.6, roughness));
    }
#else
    if (roughness < 0.6) {
      vec3 narrow = reflected(v_position, reflect(-to_eye, n), roughness, ids.g) * (u_probes_relit ? vec3(1.0) : light);
      seen = mix(narrow, seen, smoothstep(0.3, 0.6, roughness));
    }
#endif
    shown = diffuse(s) * response.b * irradiance / PI + specular_response(s, response) * seen;
    if (dot(emission, vec3(1.0)) > 0.0) shown = emission;
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
  // the screen's values are about the square roots of light: their sum is what screens blended make
  if (through < 1.0) through *= 1.0 - clamp(dot(value, vec3(1.0 / 3.0)), 0.0, 1.0);
  colour = vec4(left_of_split() ? display(photograph(v_position)) : value, through);
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

// Which surface a sample of a pixel shows: panes are passed by chance.
export const depthFragment = (panes) => (panes ? common + materials + `
in vec3 v_position;
in vec2 v_uv;
in vec3 v_normal;
flat in uint v_lamp;
void main() {
  Surface s = edited(texture(u_albedo, v_uv), texture(u_roughness, v_uv).rg, vec3(0.0), vec3(0.0), vec3(0.0), ids_at(v_uv).r, 0u);
  vec3 to_eye = u_eye - v_position;
  float facing = abs(dot(normalize(v_normal), normalize(to_eye)));
  // sheets more than a hundredth of their distance apart are told apart
  uint sheet = uint(64.0 * log2(1.0 + length(to_eye) / u_least_distance));
  if (s.clear > 0.0 && chance(sheet) < passing(s, facing)) discard;
}` : 'void main() {}');

// The mean of the samples that were added up, whose number is in the fourth channel, beside the photograph or compared with it.
export const meanFragment = common + `
in vec3 v_far;
uniform sampler2D u_sum;
uniform float u_fewest;
out vec4 colour;
void main() {
  vec4 sum = texelFetch(u_sum, ivec2(gl_FragCoord.xy), 0);
  if (sum.a < u_fewest) discard;
  vec3 mean = sum.rgb / sum.a;
  vec3 value = u_mode == 10 && u_has_photo ? error_colour(mean, photograph(v_far)) : display(mean);
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
