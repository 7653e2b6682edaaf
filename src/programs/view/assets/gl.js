// Small helpers around WebGL 2: programs, textures from the server's blocks, a target for picking.

export const FORMATS = ['srgb8', 'r8', 'rg8', 'rgb9e5', 'rg16ui'];

export function context(canvas) {
  const gl = canvas.getContext('webgl2', { antialias: true, alpha: false, powerPreference: 'high-performance' });
  if (!gl) throw new Error('This browser offers no WebGL 2. Try a current Firefox, Chromium or Safari, with graphics acceleration on.');
  return gl;
}

function shader(gl, type, source) {
  const made = gl.createShader(type);
  gl.shaderSource(made, '#version 300 es\nprecision highp float;\nprecision highp int;\n' + source);
  gl.compileShader(made);
  if (!gl.getShaderParameter(made, gl.COMPILE_STATUS) && !gl.isContextLost()) {
    throw new Error('shader: ' + gl.getShaderInfoLog(made));
  }
  return made;
}

// Attribute places are fixed by the shaders' layout(location).
export function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  gl.attachShader(made, shader(gl, gl.VERTEX_SHADER, vertex));
  gl.attachShader(made, shader(gl, gl.FRAGMENT_SHADER, fragment));
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new Error('program: ' + gl.getProgramInfoLog(made));
  }
  const uniforms = {};
  const count = gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS);
  for (let i = 0; i < count; i++) {
    const name = gl.getActiveUniform(made, i).name.replace(/\[0\]$/, '');
    uniforms[name] = gl.getUniformLocation(made, name);
  }
  return { program: made, uniforms };
}

function storage(gl, format) {
  return {
    srgb8: [gl.SRGB8_ALPHA8, gl.RGBA, gl.UNSIGNED_BYTE, 4, Uint8Array],
    r8: [gl.R8, gl.RED, gl.UNSIGNED_BYTE, 1, Uint8Array],
    rg8: [gl.RG8, gl.RG, gl.UNSIGNED_BYTE, 2, Uint8Array],
    rgb9e5: [gl.RGB9_E5, gl.RGB, gl.UNSIGNED_INT_5_9_9_9_REV, 4, Uint32Array],
    rg16ui: [gl.RG16UI, gl.RG_INTEGER, gl.UNSIGNED_SHORT, 4, Uint16Array],
    half4: [gl.RGBA16F, gl.RGBA, gl.HALF_FLOAT, 8, Uint16Array],
    float4: [gl.RGBA32F, gl.RGBA, gl.FLOAT, 16, Float32Array],
    uint4: [gl.RGBA32UI, gl.RGBA_INTEGER, gl.UNSIGNED_INT, 16, Uint32Array],
  }[format];
}

function sampling(gl, target, filter, wrapX) {
  gl.texParameteri(target, gl.TEXTURE_MAG_FILTER, filter === 'nearest' ? gl.NEAREST : gl.LINEAR);
  const min = { nearest: gl.NEAREST, linear: gl.LINEAR, mips: gl.LINEAR_MIPMAP_LINEAR }[filter];
  gl.texParameteri(target, gl.TEXTURE_MIN_FILTER, min);
  gl.texParameteri(target, gl.TEXTURE_WRAP_S, wrapX === 'repeat' ? gl.REPEAT : gl.CLAMP_TO_EDGE);
  gl.texParameteri(target, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
}

// A texture from a block of the server: 'UBTX', width, height, format, levels, then the levels' texels.
export function textureFromBlock(gl, buffer, { wrapX = 'clamp' } = {}) {
  const view = new DataView(buffer);
  if (buffer.byteLength < 16 || view.getUint32(0, false) !== 0x55425458) throw new Error('a texture arrived damaged');
  const [width, height] = [view.getUint32(4, true), view.getUint32(8, true)];
  const [format, levels] = [FORMATS[view.getUint8(12)], view.getUint8(13)];
  const [internal, layout, type, bytes, Typed] = storage(gl, format);
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  let offset = 16;
  for (let level = 0; level < levels; level++) {
    const [w, h] = [Math.max(width >> level, 1), Math.max(height >> level, 1)];
    const texels = new Typed(buffer, offset, (w * h * bytes) / Typed.BYTES_PER_ELEMENT);
    gl.texImage2D(gl.TEXTURE_2D, level, internal, w, h, 0, layout, type, texels);
    offset += w * h * bytes;
  }
  const filter = format === 'rg16ui' || format === 'rg8' ? 'nearest' : levels > 1 ? 'mips' : 'linear';
  sampling(gl, gl.TEXTURE_2D, filter, wrapX);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAX_LEVEL, levels - 1);
  const anisotropy = gl.getExtension('EXT_texture_filter_anisotropic');
  if (anisotropy && filter === 'mips') gl.texParameterf(gl.TEXTURE_2D, anisotropy.TEXTURE_MAX_ANISOTROPY_EXT, 4);
  return { texture, width, height };
}

// A texture that scripts write: 'float4' or 'uint4' (read with texelFetch), 'srgb8', 'rgb9e5' or 'half4' (filtered).
export function writtenTexture(gl, kind, width, height, texels) {
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  sampling(gl, gl.TEXTURE_2D, kind === 'float4' || kind === 'uint4' ? 'nearest' : 'linear', 'clamp');
  const written = { texture, width, height, kind };
  rewrite(gl, written, texels);
  return written;
}

export function rewrite(gl, { texture, width, height, kind }, texels) {
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  const [internal, layout, type] = storage(gl, kind);
  gl.texImage2D(gl.TEXTURE_2D, 0, internal, width, height, 0, layout, type, texels);
}

// The panoramas of the reflection probes: an array of radiance with levels of roughness, and one of distances.
export function probeTextures(gl, buffer, probes, levels, width = 256) {
  const make = (internal, filter) => {
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
    const count = filter === 'mips' ? levels : 1;
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, count, internal, width, width / 2, probes);
    sampling(gl, gl.TEXTURE_2D_ARRAY, filter, 'repeat');
    return texture;
  };
  const radiance = make(gl.RGB9_E5, 'mips');
  let offset = 0;
  for (let level = 0; level < levels; level++) {
    const [w, h] = [width >> level, width >> (level + 1)];
    const texels = new Uint32Array(buffer, offset, w * h * probes);
    gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, level, 0, 0, 0, w, h, probes, gl.RGB, gl.UNSIGNED_INT_5_9_9_9_REV, texels);
    offset += texels.byteLength;
  }
  const distance = make(gl.R16F, 'linear');
  const texels = new Uint16Array(buffer, offset, width * (width / 2) * probes);
  gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, 0, width, width / 2, probes, gl.RED, gl.HALF_FLOAT, texels);
  return { radiance, distance };
}

// A picture of four half floats a pixel with depth, to which samples are added; null where the card cannot.
export function sumTarget(gl, width, height) {
  if (!gl.getExtension('EXT_color_buffer_float') && !gl.getExtension('EXT_color_buffer_half_float')) return null;
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, width, height);
  sampling(gl, gl.TEXTURE_2D, 'nearest', 'clamp');
  const depth = gl.createRenderbuffer();
  gl.bindRenderbuffer(gl.RENDERBUFFER, depth);
  gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT24, width, height);
  const framebuffer = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
  gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, depth);
  const complete = gl.checkFramebufferStatus(gl.FRAMEBUFFER) === gl.FRAMEBUFFER_COMPLETE;
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  const target = { framebuffer, texture, depth, width, height };
  if (complete) return target;
  dropSumTarget(gl, target);
  return null;
}

export function dropSumTarget(gl, { framebuffer, texture, depth }) {
  gl.deleteFramebuffer(framebuffer);
  gl.deleteTexture(texture);
  gl.deleteRenderbuffer(depth);
}

// One pixel of four integers with a depth buffer: what the pick pass draws into.
export function pickTarget(gl) {
  const framebuffer = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
  for (const [attachment, format] of [[gl.COLOR_ATTACHMENT0, gl.RGBA32UI], [gl.DEPTH_ATTACHMENT, gl.DEPTH_COMPONENT24]]) {
    const buffer = gl.createRenderbuffer();
    gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
    gl.renderbufferStorage(gl.RENDERBUFFER, format, 1, 1);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, attachment, gl.RENDERBUFFER, buffer);
  }
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  return framebuffer;
}

// The scene's mesh from the server's block, ready to draw.
export function meshFromBlock(gl, buffer, vertices, triangles) {
  const vao = gl.createVertexArray();
  gl.bindVertexArray(vao);
  const put = (target, bytes) => {
    gl.bindBuffer(target, gl.createBuffer());
    gl.bufferData(target, bytes, gl.STATIC_DRAW);
  };
  let offset = 0;
  const part = (bytes) => new Uint8Array(buffer, (offset += bytes) - bytes, bytes);
  put(gl.ARRAY_BUFFER, part(vertices * 12));
  gl.enableVertexAttribArray(0);
  gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 12, 0);
  put(gl.ARRAY_BUFFER, part(vertices * 8));
  gl.enableVertexAttribArray(1);
  gl.vertexAttribPointer(1, 2, gl.FLOAT, false, 8, 0);
  put(gl.ARRAY_BUFFER, part(vertices * 4));
  gl.enableVertexAttribArray(2);
  gl.vertexAttribPointer(2, 3, gl.BYTE, true, 4, 0);
  gl.enableVertexAttribArray(3);
  gl.vertexAttribIPointer(3, 1, gl.UNSIGNED_BYTE, 4, 3);
  put(gl.ELEMENT_ARRAY_BUFFER, part(triangles * 12));
  gl.bindVertexArray(null);
  return { vao, count: triangles * 3 };
}
