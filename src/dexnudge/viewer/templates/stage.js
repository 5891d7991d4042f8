"use strict";
// Draws bodies with WebGL 2 and lets one look around them. All lengths are metres; matrices are column-major.
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
const GLASS = 0.25; // opacity of what of a robot hides object or hand
const MOMENTS = 40; // configurations that are looked at for it

// shown() gives what is to be seen now: poses (3 x 4 of each body, row by row), contacts, move (of all bodies that move and
// of the contacts), arrow (where its mesh is moved, null for none), opacity of the surroundings.
// Returns the function that draws anew, or null where the browser cannot.
const createStage = (data, shown) => {
  const stage = document.getElementById("stage");
  const canvas = stage.querySelector("canvas");
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, premultipliedAlpha: true });

  const add = (a, b, scale = 1) => a.map((v, k) => v + scale * b[k]);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => a.map((v) => v / Math.hypot(...a));

  const home = data.camera;
  let eye = structuredClone(home);

  const vertexShader = `#version 300 es
    uniform mat4 clip, pose;
    in vec3 position; in vec3 normal;
    out vec3 place; out vec3 facing;
    void main() {
      vec4 world = pose * vec4(position, 1.0);
      place = world.xyz; facing = mat3(pose) * normal;
      gl_Position = clip * world;
    }`;
  const fragmentShader = `#version 300 es
    precision highp float;
    uniform vec3 colour, camera, light; uniform float opacity, flat_colour;
    in vec3 place; in vec3 facing;
    out vec4 pixel;
    void main() {
      vec3 sight = normalize(place - camera);
      vec3 n = normalize(facing + vec3(1e-9));
      if (dot(n, sight) > 0.0) n = -n;
      vec3 sky = mix(vec3(0.34, 0.32, 0.30), vec3(0.47, 0.50, 0.54), 0.5 + 0.5 * n.z);
      float key = max(0.0, dot(n, light));
      vec3 lit = pow(colour, vec3(2.2)) * (sky + vec3(0.62, 0.60, 0.56) * key + 0.22 * abs(dot(n, sight)));
      lit += 0.04 * pow(max(0.0, dot(n, normalize(light - sight))), 40.0);
      vec3 shown = mix(pow(min(lit, vec3(1.0)), vec3(1.0 / 2.2)), colour, flat_colour);
      pixel = vec4(shown * opacity, opacity);
    }`;

  if (!gl) {
    const message = document.createElement("div");
    message.id = "failure";
    message.textContent = "This browser offers no WebGL 2, so the scene cannot be drawn. The numbers beside are complete.";
    stage.append(message);
    return null;
  }

  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertexShader], [gl.FRAGMENT_SHADER, fragmentShader]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.bindAttribLocation(program, 0, "position");
  gl.bindAttribLocation(program, 1, "normal");
  gl.linkProgram(program);
  gl.useProgram(program);
  const uniform = Object.fromEntries(["clip", "pose", "colour", "camera", "light", "opacity", "flat_colour"].map(
    (name) => [name, gl.getUniformLocation(program, name)]));

  const buffer = (kind, content) => {
    const made = gl.createBuffer();
    gl.bindBuffer(kind, made);
    gl.bufferData(kind, content, gl.STATIC_DRAW);
    return made;
  };
  const shapes = data.geometries.map((geometry) => {
    const faces = gl.createVertexArray();
    gl.bindVertexArray(faces);
    buffer(gl.ARRAY_BUFFER, bytes(geometry.positions));
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    buffer(gl.ARRAY_BUFFER, bytes(geometry.normals));
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(1, 3, gl.BYTE, true, 4, 0);
    const indices = bytes(geometry.indices);
    buffer(gl.ELEMENT_ARRAY_BUFFER, indices);
    const edges = gl.createVertexArray();
    gl.bindVertexArray(edges);
    const ends = bytes(geometry.edges);
    buffer(gl.ARRAY_BUFFER, ends);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    return {
      faces, edges, edgeCount: ends.byteLength / 12, closed: geometry.closed,
      count: indices.byteLength / geometry.index_bytes, type: geometry.index_bytes === 4 ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT,
    };
  });

  // As in pictures, what of a robot stands before object or hand in one configuration or another is glass throughout. Bodies
  // are taken for their boxes; an object is seen by the corners and the middle of its box, a link by the middle.
  const boxes = data.geometries.map((geometry) => {
    const points = new Float32Array(bytes(geometry.positions));
    const ends = [0, 1, 2].map((axis) => {
      let low = Infinity, high = -Infinity;
      for (let k = axis; k < points.length; k += 3) { low = Math.min(low, points[k]); high = Math.max(high, points[k]); }
      return [low, high];
    });
    const at = (x, y, z) => [x, y, z].map((share, axis) => ends[axis][0] + share * (ends[axis][1] - ends[axis][0]));
    const sides = [0.05, 0.95];
    return { ends, middle: at(0.5, 0.5, 0.5), corners: sides.flatMap((x) => sides.flatMap((y) => sides.map((z) => at(x, y, z)))) };
  });
  const boxOf = (k) => boxes[data.bodies[k].geometry];
  const placed = (poses, k, p) => [0, 4, 8].map((row) => dot(poses.subarray(12 * k + row, 12 * k + row + 3), p) + poses[12 * k + row + 3]);
  const unplaced = (poses, k, p) => [0, 1, 2].map((axis) =>
    [0, 4, 8].reduce((sum, row, other) => sum + poses[12 * k + row + axis] * (p[other] - poses[12 * k + row + 3]), 0));
  const crosses = (ends, from, to) => {
    let enter = 0, leave = 1;
    ends.forEach(([low, high], axis) => {
      const way = to[axis] - from[axis] || 1e-12;
      const [near, far] = [(low - from[axis]) / way, (high - from[axis]) / way].sort((a, b) => a - b);
      enter = Math.max(enter, near);
      leave = Math.min(leave, far);
    });
    return enter < leave;
  };
  const every = Math.ceil(data.configurations.length / MOMENTS);
  const moments = data.configurations.filter((_, index) => index % every === 0).map((entry) => {
    const poses = new Float32Array(bytes(entry.poses));
    const goals = data.bodies.flatMap(({ role }, k) => {
      if (!["object", "link", "fingertip"].includes(role)) return [];
      const { middle, corners } = boxOf(k);
      return (role === "object" ? [middle, ...corners] : [middle]).map((point) => placed(poses, k, point));
    });
    return { poses, goals };
  });
  let glass = [], lookedFrom = "";
  const findGlass = (position) => {
    if (lookedFrom === String(position)) return;
    lookedFrom = String(position);
    glass = data.bodies.map((entry, k) => entry.glass && moments.some(({ poses, goals }) => {
      const from = unplaced(poses, k, position);
      return goals.some((goal) => crosses(boxOf(k).ends, from, unplaced(poses, k, goal)));
    }));
  };

  const matrix = (rows12, move) => [
    rows12[0], rows12[4], rows12[8], 0, rows12[1], rows12[5], rows12[9], 0, rows12[2], rows12[6], rows12[10], 0,
    rows12[3] + move[0], rows12[7] + move[1], rows12[11] + move[2], 1];
  const identity = (move) => matrix([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0], move);

  function axes() {
    const backward = [Math.cos(eye.elevation) * Math.cos(eye.azimuth), Math.cos(eye.elevation) * Math.sin(eye.azimuth), Math.sin(eye.elevation)];
    const right = unit(cross([0, 0, 1], backward));
    return { backward, right, up: cross(backward, right) };
  }

  function clipMatrix({ backward, right, up }, position, tangent) {
    const aspect = canvas.width / canvas.height;
    const near = eye.distance / 50, far = eye.distance * 50 + 5;
    const row = (axis, scale) => [axis[0] * scale, axis[1] * scale, axis[2] * scale, -dot(axis, position) * scale];
    const x = row(right, 1 / (tangent * aspect)), y = row(up, 1 / tangent);
    const depth = row(backward, (far + near) / (near - far)), w = row(backward, -1);
    depth[3] += 2 * far * near / (near - far);
    return [0, 1, 2, 3].flatMap((k) => [x[k], y[k], depth[k], w[k]]);
  }

  function draw() {
    const scale = Math.min(2, window.devicePixelRatio || 1);
    canvas.width = Math.max(1, Math.round(stage.clientWidth * scale));
    canvas.height = Math.max(1, Math.round(stage.clientHeight * scale));
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.depthMask(true);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.CULL_FACE);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.enable(gl.BLEND);

    const frame = axes();
    // A tall stage must still show the whole width that a 4:3 picture shows.
    const tangent = home.tangent * Math.max(1, (4 / 3) * canvas.height / canvas.width);
    const position = add(eye.target, frame.backward, eye.distance);
    findGlass(position);
    const turn = eye.azimuth - 50 * Math.PI / 180, rise = 55 * Math.PI / 180;
    gl.uniformMatrix4fv(uniform.clip, false, clipMatrix(frame, position, tangent));
    gl.uniform3fv(uniform.camera, position);
    gl.uniform3fv(uniform.light, [Math.cos(rise) * Math.cos(turn), Math.cos(rise) * Math.sin(turn), Math.sin(rise)]);

    const { poses, contacts, move, arrow, opacity } = shown();
    const still = [0, 0, 0];
    const body = (shape, pose, colour, opacity) => {
      gl.bindVertexArray(shape.faces);
      gl.uniformMatrix4fv(uniform.pose, false, pose);
      gl.uniform3fv(uniform.colour, colour);
      gl.uniform1f(uniform.opacity, opacity);
      gl.uniform1f(uniform.flat_colour, 0);
      gl.drawElements(gl.TRIANGLES, shape.count, shape.type, 0);
    };
    const poseOf = (k) => matrix(poses.subarray(12 * k, 12 * k + 12), data.bodies[k].moves ? move : still);

    data.bodies.forEach((entry, k) => {
      if (!entry.surrounds && !glass[k]) body(shapes[entry.geometry], poseOf(k), entry.colour, 1);
    });
    if (arrow) body(shapes[data.arrow], identity(arrow), data.palette.arrow, 1);
    for (const point of contacts) body(shapes[data.ball], identity(add(point, move)), data.palette.contact, 1);

    data.bodies.forEach((entry, k) => {
      const seen = glass[k] ? GLASS : entry.surrounds ? opacity : 0;
      if (!seen) return;
      const shape = shapes[entry.geometry];
      if (shape.closed) gl.enable(gl.CULL_FACE);
      gl.depthMask(seen === 1);
      gl.enable(gl.POLYGON_OFFSET_FILL);
      gl.polygonOffset(1, 1);
      body(shape, poseOf(k), entry.colour, seen);
      gl.disable(gl.POLYGON_OFFSET_FILL);
      gl.disable(gl.CULL_FACE);
      gl.bindVertexArray(shape.edges);
      gl.vertexAttrib3f(1, 0, 0, 1);
      gl.uniform3fv(uniform.colour, data.palette.edge);
      gl.uniform1f(uniform.flat_colour, 1);
      gl.uniform1f(uniform.opacity, 0.7 * Math.min(1, 0.35 + seen));
      gl.drawArrays(gl.LINES, 0, shape.edgeCount);
    });
    // Contacts show faintly through what hides them.
    gl.depthMask(false);
    gl.depthFunc(gl.GREATER);
    gl.enable(gl.CULL_FACE);
    for (const point of contacts) body(shapes[data.ball], identity(add(point, move)), data.palette.contact, 0.5);
    gl.depthFunc(gl.LESS);
    gl.depthMask(true);
  }
  let waiting = false;
  const redraw = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; draw(); });
  };
  window.addEventListener("resize", redraw);

  const fingers = new Map();
  const zoom = (factor) => { eye.distance = Math.min(20, Math.max(0.03, eye.distance * factor)); };
  const spread = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a.x - b.x, a.y - b.y); };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    const last = fingers.get(event.pointerId);
    if (!last) return;
    const before = fingers.size === 2 ? spread() : 0;
    const dx = event.clientX - last.x, dy = event.clientY - last.y;
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (fingers.size === 1 && !event.shiftKey && !(event.buttons & 6)) {
      eye.azimuth -= dx * 0.008;
      eye.elevation = Math.min(1.55, Math.max(-1.55, eye.elevation + dy * 0.008));
    } else {
      if (before) zoom(before / Math.max(1, spread()));
      const { right, up } = axes();
      const metres = 2 * eye.distance * home.tangent / canvas.clientHeight / Math.max(1, fingers.size);
      eye.target = add(add(eye.target, right, -dx * metres), up, dy * metres);
    }
    redraw();
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(event.deltaY * 0.001)); redraw(); }, { passive: false });
  canvas.addEventListener("dblclick", () => { eye = structuredClone(home); redraw(); });
  return redraw;
};
