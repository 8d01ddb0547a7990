// Draws sorted Gaussians with WebGL 2: a quad for each, blended from far to near.

const TEXELS = 3; // of a Gaussian's record: 12 words
const COLUMNS = 512; // Gaussians per row of the texture

// Projects as clgs/reference/stages/project.py does: the covariance with the Jacobian at slopes
// within limits, blurred; whitened offsets y with alpha = opacity exp(-|y|^2 / 2).
const VERTEX = `#version 300 es
precision highp float;
precision highp int;
uniform highp usampler2D records;
uniform mat3 rotation;
uniform vec3 translation;
uniform vec2 focal, principal, size;
uniform vec4 limits;
uniform float blur, alphaCut, near;
in uint index;
out vec2 y;
flat out vec4 color;
void main() {
  ivec2 at = ivec2(${TEXELS} * int(index % ${COLUMNS}u), int(index / ${COLUMNS}u));
  uvec4 first = texelFetch(records, at, 0);
  uvec4 second = texelFetch(records, at + ivec2(1, 0), 0);
  uvec4 third = texelFetch(records, at + ivec2(2, 0), 0);
  vec3 p = rotation * uintBitsToFloat(first.xyz) + translation;
  float opacity = uintBitsToFloat(first.w);
  vec4 c = uintBitsToFloat(second);
  vec2 d = uintBitsToFloat(third.xy);
  mat3 covariance = mat3(c.x, c.y, c.z, c.y, c.w, d.x, c.z, d.x, d.y);
  color = vec4(unpackHalf2x16(third.z), uintBitsToFloat(third.w), opacity);
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  if (p.z <= near) return;
  vec2 slope = p.xy / p.z, inside = clamp(slope, limits.xz, limits.yw);
  mat3 rows = transpose(rotation);
  vec3 a = focal.x / p.z * (rows[0] - inside.x * rows[2]);
  vec3 b = focal.y / p.z * (rows[1] - inside.y * rows[2]);
  vec3 onA = covariance * a;
  float xx = dot(a, onA), xy = dot(b, onA), yy = dot(b, covariance * b);
  float least = blur * (xx + yy + blur); // what blurring alone makes of the determinant
  xx += blur;
  yy += blur;
  float determinant = max(xx * yy - xy * xy, least);
  float reach = sqrt(2.0 * log(opacity / alphaCut));
  y = reach * vec2(float(gl_VertexID & 1) * 2.0 - 1.0, float(gl_VertexID >> 1) * 2.0 - 1.0);
  float dx = y.x * sqrt(xx);
  vec2 pixel = focal * slope + principal
    + vec2(dx, dx * xy / xx + y.y * sqrt(determinant / xx));
  vec2 extent = reach * sqrt(vec2(xx, yy)), middle = focal * slope + principal;
  if (any(lessThan(middle + extent, vec2(0.0))) || any(greaterThan(middle - extent, size))) return;
  gl_Position = vec4(2.0 * pixel / size - 1.0, 0.0, 1.0) * vec4(1.0, -1.0, 1.0, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
uniform float alphaCut, alphaMax;
in vec2 y;
flat in vec4 color;
out vec4 result;
void main() {
  float alpha = color.a * exp(-0.5 * dot(y, y));
  if (!(alpha >= alphaCut)) discard;
  alpha = min(alpha, alphaMax);
  result = vec4(color.rgb * alpha, alpha);
}`;

// Half floats to the canvas: nothing is changed, so colors are shown as they are.
const COPY_VERTEX = `#version 300 es
void main() {
  gl_Position = vec4(float(gl_VertexID & 1) * 4.0 - 1.0, float(gl_VertexID >> 1) * 4.0 - 1.0, 0, 1);
}`;
const COPY_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D picture;
out vec4 result;
void main() {
  result = vec4(texelFetch(picture, ivec2(gl_FragCoord.xy), 0).rgb, 1.0);
}`;

function makeProgram(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.bindAttribLocation(program, 0, "index");
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new Error(`a shader does not build: ${gl.getProgramInfoLog(program)}`);
  }
  const uniforms = {};
  for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
    const {name} = gl.getActiveUniform(program, i);
    uniforms[name] = gl.getUniformLocation(program, name);
  }
  return {program, uniforms};
}

class Renderer {
  constructor(canvas) {
    this.canvas = canvas;
    const wishes = {alpha: false, antialias: false, depth: false, powerPreference: "high-performance"};
    const gl = this.gl = canvas.getContext("webgl2", wishes);
    if (!gl) throw new Error("this browser has no WebGL 2; try a newer one");
    this.half = gl.getExtension("EXT_color_buffer_float")
      || gl.getExtension("EXT_color_buffer_half_float");
    this.splats = makeProgram(gl, VERTEX, FRAGMENT);
    this.copy = makeProgram(gl, COPY_VERTEX, COPY_FRAGMENT);
    this.records = this.makeTexture();
    this.picture = this.makeTexture();
    this.frame = gl.createFramebuffer();
    this.rows = this.count = this.room = 0;
    this.vertices = gl.createVertexArray();
    this.order = gl.createBuffer();
    gl.bindVertexArray(this.vertices);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(0, 1);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  makeTexture() {
    const gl = this.gl, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    return texture;
  }

  // What is to be drawn: records (n, 12) if they are new, and their order, far to near.
  set(records, order) {
    const gl = this.gl;
    if (records) this.upload(records);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    if (order.length > this.room) {
      this.room = Math.ceil(order.length * 1.25);
      gl.bufferData(gl.ARRAY_BUFFER, 4 * this.room, gl.STREAM_DRAW);
    }
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, order);
    this.count = order.length;
  }

  upload(records) {
    const gl = this.gl, width = TEXELS * COLUMNS, row = 4 * width;
    const rows = Math.max(1, Math.ceil(records.length / row));
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (rows > most) {
      throw new Error("the scene has more Gaussians than this device can draw");
    }
    gl.bindTexture(gl.TEXTURE_2D, this.records);
    if (rows > this.rows) {
      this.rows = Math.min(most, Math.ceil(rows * 1.25));
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32UI, width, this.rows, 0, gl.RGBA_INTEGER,
        gl.UNSIGNED_INT, null);
    }
    const whole = Math.floor(records.length / row), rest = (records.length - whole * row) / 4;
    const part = (top, columns, height) => gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, top, columns,
      height, gl.RGBA_INTEGER, gl.UNSIGNED_INT, records.subarray(top * row));
    if (whole > 0) part(0, width, whole);
    if (rest > 0) part(whole, rest, 1);
  }

  resize(width, height) {
    const gl = this.gl;
    if (this.canvas.width === width && this.canvas.height === height && this.sized) return;
    this.sized = true;
    this.canvas.width = width;
    this.canvas.height = height;
    if (!this.half) return;
    gl.bindTexture(gl.TEXTURE_2D, this.picture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, width, height, 0, gl.RGBA, gl.HALF_FLOAT, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.picture, 0);
  }

  // view: a camera as Camera.pinhole gives it; scene: the settings of the file.
  draw(view, scene) {
    const gl = this.gl, {program, uniforms} = this.splats;
    this.resize(view.width, view.height);
    gl.viewport(0, 0, view.width, view.height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.half ? this.frame : null);
    gl.clearColor(...scene.background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(program);
    const marginX = scene.margin * view.width, marginY = scene.margin * view.height;
    gl.uniformMatrix3fv(uniforms.rotation, true, view.rotation);
    gl.uniform3fv(uniforms.translation, view.translation);
    gl.uniform2f(uniforms.focal, view.fx, view.fy);
    gl.uniform2f(uniforms.principal, view.cx, view.cy);
    gl.uniform2f(uniforms.size, view.width, view.height);
    gl.uniform4f(uniforms.limits, (-marginX - view.cx) / view.fx,
      (view.width + marginX - view.cx) / view.fx, (-marginY - view.cy) / view.fy,
      (view.height + marginY - view.cy) / view.fy);
    for (const name of ["blur", "near", "alphaCut", "alphaMax"]) {
      gl.uniform1f(uniforms[name], scene[name]);
    }
    gl.bindTexture(gl.TEXTURE_2D, this.records);
    gl.bindVertexArray(this.vertices);
    gl.enable(gl.BLEND);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.count);
    gl.disable(gl.BLEND);
    if (this.half) this.show();
  }

  // Copy the picture to the canvas.
  show() {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.bindVertexArray(null);
    gl.useProgram(this.copy.program);
    gl.bindTexture(gl.TEXTURE_2D, this.picture);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}
