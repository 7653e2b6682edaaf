// Reflections traced in the shader: the texture of the scene's boxes and triangles, and the search through them.

import { writtenTexture } from './gl.js';

const PER_ROW = 1024; // records of four texels
const STACK = 64; // the server sends no deeper tree

// Nodes from the server and the mesh's triangles in one texture of integers, 16 words each: a triangle's corners (9), their atlas
// coordinates (6) and the number of its lamp. null where the server sent no tree.
export function rayTexture(gl, tree, mesh, { vertices, triangles }) {
  const nodes = new Uint32Array(tree);
  if (!nodes.length) return null;
  const records = nodes.length / 16 + triangles;
  const rows = Math.ceil(records / PER_ROW);
  if (rows > gl.getParameter(gl.MAX_TEXTURE_SIZE)) return null;
  const words = new Uint32Array(rows * PER_ROW * 16);
  words.set(nodes);
  const floats = new Float32Array(words.buffer);
  const [positions, uvs] = [new Float32Array(mesh, 0, vertices * 3), new Float32Array(mesh, vertices * 12, vertices * 2)];
  const [tags, corners] = [new Uint8Array(mesh, vertices * 20, vertices * 4), new Uint32Array(mesh, vertices * 24, triangles * 3)];
  for (let t = 0, at = nodes.length; t < triangles; t++, at += 16) {
    for (let c = 0; c < 3; c++) {
      const v = corners[3 * t + c];
      for (let k = 0; k < 3; k++) floats[at + 3 * c + k] = positions[3 * v + k];
      for (let k = 0; k < 2; k++) floats[at + 9 + 2 * c + k] = uvs[2 * v + k];
    }
    words[at + 15] = tags[4 * corners[3 * t + 2] + 3];
  }
  const { texture } = writtenTexture(gl, 'uint4', PER_ROW * 4, rows, words);
  return { texture, nodes: nodes.length / 16 };
}

export const tracing = `
uniform highp usampler2D u_rays;
uniform int u_ray_nodes;
const uint LEAF = 0x80000000u;
const float FAR = 1e30;

struct Met { float t; vec2 uv; vec3 n; uint lamp; };

uvec4 ray_texel(int i, int k) {
  return texelFetch(u_rays, ivec2(4 * (i % ${PER_ROW}) + k, i / ${PER_ROW}), 0);
}
// Distance at which a ray enters a box, FAR if it does not before 'nearest'.
float entered(vec3 low, vec3 high, vec3 origin, vec3 inverse_direction, float nearest) {
  vec3 a = (low - origin) * inverse_direction;
  vec3 b = (high - origin) * inverse_direction;
  vec3 first = min(a, b);
  vec3 last = max(a, b);
  float enter = max(max(first.x, first.y), max(first.z, 0.0));
  return enter <= min(min(last.x, last.y), min(last.z, nearest)) ? enter : FAR;
}
// Moeller and Trumbore 1997.
void meet_triangle(int i, vec3 origin, vec3 d, inout Met met) {
  uvec4 ua = ray_texel(i, 0), ub = ray_texel(i, 1), uc = ray_texel(i, 2), ud = ray_texel(i, 3);
  vec4 a = uintBitsToFloat(ua), b = uintBitsToFloat(ub), c = uintBitsToFloat(uc), e = uintBitsToFloat(ud);
  vec3 p = a.xyz;
  vec3 s = vec3(a.w, b.xy) - p;
  vec3 q = vec3(b.zw, c.x) - p;
  vec3 h = cross(d, q);
  float det = dot(s, h);
  if (det == 0.0) return;
  vec3 o = origin - p;
  float u = dot(o, h) / det;
  vec3 g = cross(o, s);
  float v = dot(d, g) / det;
  float t = dot(q, g) / det;
  if (u < 0.0 || v < 0.0 || u + v > 1.0 || t <= 0.0 || t >= met.t) return;
  met = Met(t, c.yz * (1.0 - u - v) + vec2(c.w, e.x) * u + e.yz * v, normalize(cross(s, q)), ud.w);
}
// The nearest triangle along a ray; t = FAR where there is none.
Met trace(vec3 origin, vec3 d) {
  Met met = Met(FAR, vec2(0.0), vec3(0.0, 1.0, 0.0), 0u);
  vec3 inverse_direction = 1.0 / mix(d, vec3(1e-9), lessThan(abs(d), vec3(1e-9)));
  uint stack[${STACK}];
  int top = 0;
  uint at = 0u;
  for (int step = 0; step < 8192; step++) {
    if ((at & LEAF) != 0u) {
      meet_triangle(u_ray_nodes + int(at & ~LEAF), origin, d, met);
    } else {
      uvec4 a = ray_texel(int(at), 0), b = ray_texel(int(at), 1), c = ray_texel(int(at), 2), e = ray_texel(int(at), 3);
      float first = entered(uintBitsToFloat(a.xyz), uintBitsToFloat(b.xyz), origin, inverse_direction, met.t);
      float second = entered(uintBitsToFloat(c.xyz), uintBitsToFloat(e.xyz), origin, inverse_direction, met.t);
      if (min(first, second) < FAR) {
        bool swapped = second < first;
        if (max(first, second) < FAR) stack[top++] = swapped ? a.w : b.w;
        at = swapped ? b.w : a.w;
        continue;
      }
    }
    if (top == 0) break;
    at = stack[--top];
  }
  return met;
}`;
