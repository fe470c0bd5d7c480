"use strict";
// A view that is turned by dragging: height maps and lines, drawn by the browser itself (WebGL 2).
// Data, by twin/report/view.py: {grids: [{name, nx, ny, x, y, z, rgb}],
// lines: [{name, rgb, points}], homes: {name: {middle, radius, enlarged, turn, lift, shows}}}.
(() => {
  const levels = text => Uint8Array.from(atob(text), one => one.charCodeAt(0));
  const numbers = text => new Float32Array(levels(text).buffer);
  const VERTEX = `#version 300 es
    in vec3 place; in vec3 colour;
    uniform mat4 view; uniform float enlarged;
    out vec3 shade; out vec3 world;
    void main() {
      world = vec3(place.xy, place.z * enlarged);
      shade = colour;
      gl_Position = view * vec4(world, 1.0);
    }`;
  const FRAGMENT = `#version 300 es
    precision highp float;
    in vec3 shade; in vec3 world;
    uniform bool lit;
    out vec4 pixel;
    void main() {
      vec3 normal = normalize(cross(dFdx(world), dFdy(world)));
      float light = 0.35 + 0.65 * abs(dot(normal, normalize(vec3(-0.5, 0.4, 0.75))));
      pixel = vec4(lit ? shade * light : shade, 1.0);
    }`;

  const program = gl => {
    const made = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
    return made;
  };

  // Two triangles for each cell with a height at all four corners.
  const facets = (grid, z) => {
    const index = [];
    for (let row = 0; row + 1 < grid.ny; row++) for (let col = 0; col + 1 < grid.nx; col++) {
      const a = row * grid.nx + col, b = a + 1, c = a + grid.nx, d = c + 1;
      if ([a, b, c, d].every(one => Number.isFinite(z[one]))) index.push(a, b, c, b, d, c);
    }
    return new Uint32Array(index);
  };

  const buffer = (gl, data, kind) => {
    const made = gl.createBuffer();
    gl.bindBuffer(kind, made);
    gl.bufferData(kind, data, gl.STATIC_DRAW);
    return made;
  };

  const body = (gl, name, mode, place, colour, index) => ({
    name, mode, shown: true, count: index.length,
    place: buffer(gl, place, gl.ARRAY_BUFFER),
    colour: buffer(gl, colour, gl.ARRAY_BUFFER),
    index: buffer(gl, index, gl.ELEMENT_ARRAY_BUFFER),
  });

  const surface = (gl, grid) => {
    const z = numbers(grid.z), rgb = levels(grid.rgb), place = new Float32Array(3 * z.length);
    const [x0, dx] = grid.x, [y0, dy] = grid.y;
    z.forEach((height, at) => place.set(
      [x0 + dx * (at % grid.nx), y0 + dy * Math.floor(at / grid.nx), Number.isFinite(height) ? height : 0],
      3 * at));
    return body(gl, grid.name, gl.TRIANGLES, place, rgb, facets(grid, z));
  };

  const wire = (gl, line) => {
    const place = numbers(line.points), count = place.length / 3;
    const colour = new Uint8Array(place.length);
    for (let at = 0; at < count; at++) colour.set(line.rgb, 3 * at);
    return body(gl, line.name, gl.LINES, place, colour, Uint32Array.from({length: count}, (_, at) => at));
  };

  // Columns of the matrix that turns, moves and projects; perspective with the eye at distance 4.
  const matrix = (state, wide) => {
    const [ca, sa, ce, se] = [Math.cos(state.turn), Math.sin(state.turn), Math.cos(state.lift), Math.sin(state.lift)];
    const rows = [[ca, sa, 0], [-sa * se, ca * se, ce], [sa * ce, -ca * ce, se]];
    const scale = state.zoom / state.radius, m = new Float32Array(16);
    const at = [state.middle[0], state.middle[1], state.middle[2] * state.enlarged];
    rows.forEach((row, i) => {
      const factor = [scale / wide[0], scale / wide[1], -scale / 100][i];
      row.forEach((value, j) => { m[4 * j + i] = factor * value; });
      m[12 + i] = -factor * row.reduce((sum, value, j) => sum + value * at[j], 0);
    });
    const depth = rows[2].map(value => -scale * value / 4);
    depth.forEach((value, j) => { m[4 * j + 3] = value; });
    m[15] = 1 + scale / 4 * rows[2].reduce((sum, value, j) => sum + value * at[j], 0);
    return m;
  };

  const start = holder => {
    const canvas = holder.querySelector("canvas");
    const gl = canvas.getContext("webgl2", {antialias: true, preserveDrawingBuffer: true});
    if (!gl) { holder.classList.add("missing"); return; }
    const data = JSON.parse(holder.querySelector("script").textContent), made = program(gl);
    const bodies = [...data.grids.map(one => surface(gl, one)), ...data.lines.map(one => wire(gl, one))];
    const where = name => gl.getUniformLocation(made, name);
    const [view, enlarged, lit] = ["view", "enlarged", "lit"].map(where);
    const state = {turn: 0, lift: 0, zoom: 1, enlarged: 1, radius: 1, middle: [0, 0, 0]};

    const draw = () => {
      const ratio = window.devicePixelRatio || 1;
      canvas.width = Math.round(canvas.clientWidth * ratio);
      canvas.height = Math.round(canvas.clientHeight * ratio);
      gl.viewport(0, 0, canvas.width, canvas.height);
      gl.clearColor(0.965, 0.973, 0.98, 1);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.enable(gl.DEPTH_TEST);
      gl.useProgram(made);
      const aspect = canvas.width / canvas.height;
      gl.uniformMatrix4fv(view, false, matrix(state, aspect > 1 ? [aspect, 1] : [1, 1 / aspect]));
      gl.uniform1f(enlarged, state.enlarged);
      for (const one of bodies.filter(one => one.shown)) {
        gl.uniform1i(lit, one.mode === gl.TRIANGLES ? 1 : 0);
        for (const [name, kind] of [["place", gl.FLOAT], ["colour", gl.UNSIGNED_BYTE]]) {
          const slot = gl.getAttribLocation(made, name);
          gl.bindBuffer(gl.ARRAY_BUFFER, one[name]);
          gl.enableVertexAttribArray(slot);
          gl.vertexAttribPointer(slot, 3, kind, kind === gl.UNSIGNED_BYTE, 0, 0);
        }
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, one.index);
        gl.drawElements(one.mode, one.count, gl.UNSIGNED_INT, 0);
      }
    };

    const go = name => {
      const home = data.homes[name];
      Object.assign(state, home, {zoom: 1});
      for (const one of bodies) one.shown = home.shows.includes(one.name);
      for (const box of holder.querySelectorAll("input"))
        box.checked = bodies.some(one => one.name === box.value && one.shown);
      draw();
    };
    holder.querySelectorAll("button").forEach(one => one.addEventListener("click", () => go(one.value)));
    holder.querySelectorAll("input").forEach(box => box.addEventListener("change", () => {
      for (const one of bodies) if (one.name === box.value) one.shown = box.checked;
      draw();
    }));
    canvas.addEventListener("pointerdown", event => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", event => {
      if (!canvas.hasPointerCapture(event.pointerId)) return;
      state.turn -= 0.01 * event.movementX;
      state.lift = Math.min(1.57, Math.max(-1.57, state.lift + 0.01 * event.movementY));
      draw();
    });
    canvas.addEventListener("wheel", event => {
      event.preventDefault();
      state.zoom = Math.min(50, Math.max(0.2, state.zoom * Math.exp(-0.001 * event.deltaY)));
      draw();
    }, {passive: false});
    canvas.addEventListener("keydown", event => {
      const step = {ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1]}[event.key];
      if (!step) return;
      event.preventDefault();
      state.turn += step[0];
      state.lift += step[1];
      draw();
    });
    window.addEventListener("resize", draw);
    go(Object.keys(data.homes)[0]);
  };
  document.querySelectorAll(".view3d").forEach(start);
})();
