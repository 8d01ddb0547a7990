// Draws sorted Gaussians with WebGL 2: a quad for each, blended from far to near. Quads are not
// instances: of four vertices each, they are slow on some devices, and very slow in software.

const TEXELS = 3; // of a Gaussian's record: 12 words
const COLUMNS = 512; // Gaussians per row of the textures

// Projects as clgs/reference/project.py does: the covariance with the Jacobian at slopes
// within limits, blurred as the size by that in the photos asks for (photos: a point, and the
// distance of the nearest camera from it); whitened offsets y with alpha = opacity exp(-|y|^2 / 2).
const VERTEX = `#version 300 es
precision highp float;
precision highp int;
uniform highp usampler2D records, order;
uniform mat3 rotation;
uniform vec3 translation;
uniform vec2 focal, principal, size;
uniform vec4 limits;
uniform vec4 photos;
uniform float farthest, enlarged, learned, blur, alphaCut, near;
out vec2 y;
flat out vec4 color;
void main() {
  int place = gl_VertexID >> 2;
  uint index = texelFetch(order, ivec2(place % ${COLUMNS}, place / ${COLUMNS}), 0).x;
  ivec2 at = ivec2(${TEXELS} * int(index % ${COLUMNS}u), int(index / ${COLUMNS}u));
  uvec4 first = texelFetch(records, at, 0);
  uvec4 second = texelFetch(records, at + ivec2(1, 0), 0);
  uvec4 third = texelFetch(records, at + ivec2(2, 0), 0);
  vec3 position = uintBitsToFloat(first.xyz), p = rotation * position + translation;
  float opacity = uintBitsToFloat(first.w);
  vec4 c = uintBitsToFloat(second);
  vec2 d = uintBitsToFloat(third.xy);
  mat3 covariance = mat3(c.x, c.y, c.z, c.y, c.w, d.x, c.z, d.x, d.y);
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  if (p.z <= near) return;
  vec2 slope = p.xy / p.z, inside = clamp(slope, limits.xz, limits.yw);
  mat3 rows = transpose(rotation);
  vec3 a = focal.x / p.z * (rows[0] - inside.x * rows[2]);
  vec3 b = focal.y / p.z * (rows[1] - inside.y * rows[2]);
  vec3 onA = covariance * a;
  float xx = dot(a, onA), xy = dot(b, onA), yy = dot(b, covariance * b);
  float square = 1.0;
  if (enlarged > 0.0) {
    float away = length(p), inside = distance(position, photos.xyz);
    float nearest = max(photos.w - inside, inside - farthest);
    float ratio = enlarged * max(nearest, min(away, farthest + inside)) / away;
    square = ratio * ratio;
  }
  float wide = blur * square + max(1.0 - square, 0.0) / 12.0, own = learned * square;
  float least = wide * (xx + yy + wide); // what blurring alone makes of the determinant
  float kept = own * (xx + yy + own);
  xx += wide;
  yy += wide;
  float determinant = max(xx * yy - xy * xy, least);
  if (own < wide) opacity *= sqrt((max(determinant - least, 0.0) + kept) / determinant);
  if (!(opacity >= alphaCut)) return;
  color = vec4(unpackHalf2x16(third.z), uintBitsToFloat(third.w), opacity);
  float reach = sqrt(2.0 * log(opacity / alphaCut));
  y = reach * (2.0 * vec2(gl_VertexID & 1, gl_VertexID >> 1 & 1) - 1.0);
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
    const gl = this.gl = canvas.getContext("webgl2",
      {alpha: false, antialias: false, depth: false, powerPreference: "high-performance"});
    if (!gl) throw new Error("this browser has no WebGL 2; try a newer one");
    this.half = gl.getExtension("EXT_color_buffer_float")
      || gl.getExtension("EXT_color_buffer_half_float");
    this.splats = makeProgram(gl, VERTEX, FRAGMENT);
    this.copy = makeProgram(gl, COPY_VERTEX, COPY_FRAGMENT);
    const words = {type: gl.UNSIGNED_INT, rows: 0};
    this.records = {...words, texture: this.makeTexture(), width: TEXELS * COLUMNS, channels: 4,
      inside: gl.RGBA32UI, format: gl.RGBA_INTEGER};
    this.order = {...words, texture: this.makeTexture(), width: COLUMNS, channels: 1,
      inside: gl.R32UI, format: gl.RED_INTEGER};
    this.picture = this.makeTexture();
    this.frame = gl.createFramebuffer();
    this.count = this.room = 0; // Gaussians that are drawn, and that there are quads for
    this.frames = this.milliseconds = 0; // complete ones, and what the last one took
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  makeTexture() {
    const gl = this.gl, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    return texture;
  }

  // What must be drawn: records (n, 12) if they are new, and their order, far to near.
  set(records, order) {
    if (records) this.upload(this.records, records);
    this.upload(this.order, order);
    this.count = order.length;
    if (this.count > this.room) this.makeQuads(Math.ceil(this.count * 1.25));
  }

  // Vertices 4 i to 4 i + 3 are two triangles.
  makeQuads(count) {
    const gl = this.gl, list = new Uint32Array(6 * count);
    for (let i = 0; i < count; i++) {
      list.set([4 * i, 4 * i + 1, 4 * i + 2, 4 * i + 2, 4 * i + 1, 4 * i + 3], 6 * i);
    }
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, list, gl.STATIC_DRAW);
    this.room = count;
  }

  // Fill a texture of words, row by row; it grows if it has to.
  upload(to, words) {
    const gl = this.gl, row = to.channels * to.width;
    const rows = Math.max(1, Math.ceil(words.length / row));
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (rows > most) throw new Error("the scene has more Gaussians than this device can draw");
    gl.bindTexture(gl.TEXTURE_2D, to.texture);
    if (rows > to.rows) {
      to.rows = Math.min(most, Math.ceil(rows * 1.25));
      gl.texImage2D(gl.TEXTURE_2D, 0, to.inside, to.width, to.rows, 0, to.format, to.type, null);
    }
    const whole = Math.floor(words.length / row);
    const rest = (words.length - whole * row) / to.channels;
    const part = (top, width, height) => gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, top, width, height,
      to.format, to.type, words.subarray(top * row));
    if (whole > 0) part(0, to.width, whole);
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

  // Whether the device still draws the last picture; it would fall behind with another one.
  busy() {
    const gl = this.gl;
    if (!this.fence || gl.isContextLost()) return false;
    if (gl.getSyncParameter(this.fence, gl.SYNC_STATUS) !== gl.SIGNALED) return true;
    gl.deleteSync(this.fence);
    this.fence = null;
    this.frames++;
    this.milliseconds = performance.now() - this.begun;
    return false;
  }

  // view: a camera as Camera.pinhole gives it; scene: the settings of the file. Once not busy().
  draw(view, scene) {
    this.begun = performance.now();
    this.drawGaussians(view, scene);
    if (this.half) this.show();
    this.fence = this.gl.fenceSync(this.gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    this.gl.flush();
  }

  drawGaussians(view, scene) {
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
    for (const name of ["blur", "near", "alphaCut", "alphaMax", "learned"]) {
      gl.uniform1f(uniforms[name], scene[name]);
    }
    const [least, greatest, x, y, z, nearest, farthest] = scene.photos;
    gl.uniform4f(uniforms.photos, x, y, z, nearest);
    gl.uniform1f(uniforms.farthest, farthest);
    const sizes = [view.fx, view.fy].map((focal) =>
      least > 0 ? focal / Math.min(Math.max(focal, least), greatest) : 0);
    gl.uniform1f(uniforms.enlarged,
      least > 0 ? Math.max(1, Math.min(...sizes)) * Math.min(1, Math.max(...sizes)) : 0);
    gl.uniform1i(uniforms.order, 1);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.order.texture);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.records.texture);
    gl.enable(gl.BLEND);
    gl.drawElements(gl.TRIANGLES, 6 * this.count, gl.UNSIGNED_INT, 0);
    gl.disable(gl.BLEND);
  }

  // Copy the picture to the canvas.
  show() {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.useProgram(this.copy.program);
    gl.bindTexture(gl.TEXTURE_2D, this.picture);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}
