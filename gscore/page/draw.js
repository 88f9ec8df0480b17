// Rendering with WebGL 2: a program, a texture of splats, and their order for each view.

const ROW = 2048; // texels in a row of the texture, as in the shader

class Renderer {
  constructor(canvas, scene, splats) {
    this.canvas = canvas;
    this.scene = scene;
    this.splats = splats;
    this.drawn = 0;
    this.setUp();
  }

  // Called initially, and again after a lost context is restored.
  setUp() {
    const options = { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" };
    const gl = (this.gl = this.canvas.getContext("webgl2", options));
    if (!gl) throw new Error("webgl2");
    this.program = this.link();
    gl.useProgram(this.program);
    this.places = new Map();
    this.store();
    this.order = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(0, 1);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.clearColor(...this.scene.background, 1);
    const { degree, turns, rest_step, color_axes } = this.scene.splats;
    gl.uniform1i(this.place("texels"), this.splats.texels);
    gl.uniform1i(this.place("degree"), degree);
    gl.uniform1f(this.place("turns"), turns);
    gl.uniform1f(this.place("restStep"), rest_step);
    gl.uniform1f(this.place("nearest"), this.scene.near);
    gl.uniform1i(this.place("compensated"), this.scene.antialias ? 1 : 0);
    gl.uniformMatrix3fv(this.place("colorAxes"), false, color_axes.flat());
  }

  link() {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, id] of [[gl.VERTEX_SHADER, "vertex"], [gl.FRAGMENT_SHADER, "fragment"]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, document.getElementById(id).textContent);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost())
        throw new Error(gl.getShaderInfoLog(shader));
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost())
      throw new Error(gl.getProgramInfoLog(program));
    return program;
  }

  place(name) {
    if (!this.places.has(name)) this.places.set(name, this.gl.getUniformLocation(this.program, name));
    return this.places.get(name);
  }

  store() {
    const { gl, splats } = this;
    const high = Math.max(1, Math.ceil((splats.count * splats.texels) / ROW));
    if (high > gl.getParameter(gl.MAX_TEXTURE_SIZE)) throw new Error("too many splats");
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
      gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32UI, ROW, high);
    const { words } = splats;
    const whole = Math.floor(words.length / (4 * ROW));
    const put = (y, width, rows, from) =>
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, y, width, rows, gl.RGBA_INTEGER, gl.UNSIGNED_INT, words, from);
    if (whole) put(0, ROW, whole, 0);
    const rest = words.length / 4 - whole * ROW;
    if (rest) put(whole, rest, 1, whole * ROW * 4);
  }

  setOrder(order) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.bufferData(gl.ARRAY_BUFFER, order, gl.DYNAMIC_DRAW);
    this.drawn = order.length;
  }

  // `lens` is { fx, fy, cx, cy } in pixels of the canvas.
  draw(eye, lens) {
    const { gl, canvas } = this;
    const rows = eye.rotation;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.uniformMatrix3fv(this.place("rotation"), true, rows.flat());
    gl.uniform3fv(this.place("position"), eye.position);
    gl.uniform4f(this.place("lens"), lens.fx, lens.fy, lens.cx, lens.cy);
    gl.uniform2f(this.place("size"), canvas.width, canvas.height);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.drawn);
  }
}
