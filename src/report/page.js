(function () {
  "use strict";
  var root = document.documentElement;
  var name = document.title;
  function finish(state) {
    root.dataset.state = state;
    document.title = name + " · " + state;
  }
  window.addEventListener("error", function (event) { finish("error: " + event.message); });

  function number(cell) {
    var value = parseFloat(cell.textContent);
    return isNaN(value) ? null : value;
  }
  function sortBy(table, column, direction) {
    var body = table.tBodies[0];
    var rows = Array.prototype.slice.call(body.rows);
    rows.sort(function (a, b) {
      var x = a.cells[column], y = b.cells[column];
      if (column === 0) { return direction * x.textContent.localeCompare(y.textContent); }
      var p = number(x), q = number(y);
      if (p === null || q === null) { return (p === null) - (q === null); }
      return direction * (p - q);
    });
    rows.forEach(function (row) { body.appendChild(row); });
    Array.prototype.forEach.call(table.tHead.rows[0].cells, function (cell, index) {
      cell.setAttribute("aria-sort", index === column ? (direction > 0 ? "ascending" : "descending") : "none");
    });
  }
  document.querySelectorAll("table.sortable").forEach(function (table) {
    Array.prototype.forEach.call(table.tHead.rows[0].cells, function (cell, column) {
      cell.querySelector("button").addEventListener("click", function () {
        var first = cell.dataset.first === "down" ? -1 : 1;
        var now = cell.getAttribute("aria-sort");
        var direction = now === "ascending" ? -1 : now === "descending" ? 1 : first;
        sortBy(table, column, direction);
      });
    });
  });

  var VERTEX = "#version 300 es\n" +
    "in vec4 a; uniform mat4 view; uniform vec3 middle; uniform float scale, full, size; out vec3 color;\n" +
    "vec3 ramp(float t) {\n" +
    "  vec3 c0 = vec3(.227,.561,.839), c1 = vec3(.31,.765,.631), c2 = vec3(.949,.878,.353), c3 = vec3(.941,.533,.227), c4 = vec3(.839,.149,.235);\n" +
    "  if (t < .17) return mix(c0, c1, t / .17); if (t < .33) return mix(c1, c2, (t - .17) / .16);\n" +
    "  if (t < .6) return mix(c2, c3, (t - .33) / .27); return mix(c3, c4, min((t - .6) / .4, 1.)); }\n" +
    "void main() { gl_Position = view * vec4((a.xyz - middle) * scale, 1.); gl_PointSize = clamp(size / gl_Position.w, 1., 8.);\n" +
    "  color = ramp(a.w / 255. * 3. / full); }";
  var FRAGMENT = "#version 300 es\nprecision mediump float; in vec3 color; out vec4 pixel; void main() { pixel = vec4(color, 1.); }";

  function bytesOf(text) {
    var raw = atob(text), bytes = new Uint8Array(raw.length);
    for (var i = 0; i < raw.length; i++) { bytes[i] = raw.charCodeAt(i); }
    return bytes;
  }
  function inflate(bytes) {
    var stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Response(stream).arrayBuffer().then(function (buffer) { return new Uint8Array(buffer); });
  }
  // Seven planes of one byte per point: low and high bytes of the x, y and z steps, then the error.
  function points(planes) {
    var count = planes.length / 7, out = new Uint16Array(4 * count);
    for (var axis = 0; axis < 3; axis++) {
      var low = 2 * axis * count, high = low + count, value = 0;
      for (var i = 0; i < count; i++) {
        value = (value + planes[low + i] + 256 * planes[high + i]) & 65535;
        out[4 * i + axis] = value;
      }
    }
    for (var j = 0; j < count; j++) { out[4 * j + 3] = planes[6 * count + j]; }
    return out;
  }

  function viewer(box) {
    var canvas = box.querySelector("canvas"), select = box.querySelector("select");
    var slider = box.querySelector("input"), shown = box.querySelector("output");
    var ends = box.querySelectorAll(".legend span b"), turn = box.querySelector("button");
    var clouds = JSON.parse(document.getElementById("clouds").textContent);
    var gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
    if (!gl) { return Promise.resolve("no WebGL 2"); }
    box.querySelector(".fallback").hidden = true;
    canvas.hidden = box.querySelector(".controls").hidden = false;
    function shader(kind, source) {
      var made = gl.createShader(kind);
      gl.shaderSource(made, source);
      gl.compileShader(made);
      if (!gl.getShaderParameter(made, gl.COMPILE_STATUS)) { throw new Error(gl.getShaderInfoLog(made)); }
      return made;
    }
    var program = gl.createProgram();
    gl.attachShader(program, shader(gl.VERTEX_SHADER, VERTEX));
    gl.attachShader(program, shader(gl.FRAGMENT_SHADER, FRAGMENT));
    gl.bindAttribLocation(program, 0, "a");
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) { throw new Error(gl.getProgramInfoLog(program)); }
    gl.useProgram(program);
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(16 / 255, 20 / 255, 24 / 255, 1);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 4, gl.UNSIGNED_SHORT, false, 8, 0);
    var at = {};
    ["view", "middle", "scale", "full", "size"].forEach(function (uniform) {
      at[uniform] = gl.getUniformLocation(program, uniform);
    });
    var count = 0, cloud = null, target = null, yaw = 0.7, pitch = 0.55, distance = 1, spinning = false;

    // Rows of the camera: right, up, back; the eye circles the middle, +Z up.
    function camera() {
      var cy = Math.cos(yaw), sy = Math.sin(yaw), cp = Math.cos(pitch), sp = Math.sin(pitch);
      return [[-sy, cy, 0], [-sp * cy, -sp * sy, cp], [cp * cy, cp * sy, sp]];
    }
    function focal() {
      var aspect = canvas.clientWidth / Math.max(1, canvas.clientHeight), fy = 1.9 * Math.min(1, aspect);
      return [fy / aspect, fy];
    }
    // Looks at the point, from the distance, from where the points fill the picture and all are in it.
    function fit(data) {
      var axes = camera(), lens = focal(), m = cloud.middle, away = 0.15, least = [], most = [];
      for (var i = 0; i < data.length; i += 4) {
        var at = axes.map(function (axis) {
          return (axis[0] * (data[i] - m[0]) + axis[1] * (data[i + 1] - m[1]) + axis[2] * (data[i + 2] - m[2])) / 65535;
        });
        for (var side = 0; side < 2; side++) {
          var part = 0.95 / lens[side] * at[2];
          least[side] = Math.min(i ? least[side] : Infinity, at[side] - part);
          most[side] = Math.max(i ? most[side] : -Infinity, at[side] + part);
        }
      }
      target = m.slice();
      for (var k = 0; k < 2; k++) {
        away = Math.max(away, lens[k] / 0.95 * (most[k] - least[k]) / 2);
        for (var l = 0; l < 3; l++) { target[l] += 65535 * axes[k][l] * (most[k] + least[k]) / 2; }
      }
      distance = away;
    }

    function draw() {
      var ratio = window.devicePixelRatio || 1;
      canvas.width = Math.max(1, Math.round(canvas.clientWidth * ratio));
      canvas.height = Math.max(1, Math.round(canvas.clientHeight * ratio));
      gl.viewport(0, 0, canvas.width, canvas.height);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      if (!count) { return; }
      var near = 0.01, far = 20, a = (far + near) / (near - far), b = 2 * far * near / (near - far);
      var lens = focal(), axes = camera(), right = axes[0], up = axes[1], back = axes[2];
      var matrix = new Float32Array(16);
      for (var i = 0; i < 3; i++) {
        matrix[4 * i] = lens[0] * right[i]; matrix[4 * i + 1] = lens[1] * up[i];
        matrix[4 * i + 2] = a * back[i]; matrix[4 * i + 3] = -back[i];
      }
      matrix[14] = a * -distance + b; matrix[15] = distance;
      gl.uniformMatrix4fv(at.view, false, matrix);
      gl.uniform3fv(at.middle, target);
      gl.uniform1f(at.scale, 1 / 65535);
      gl.uniform1f(at.full, +slider.value);
      gl.uniform1f(at.size, canvas.height * 1.6 / Math.sqrt(count) * 1.5);
      gl.drawArrays(gl.POINTS, 0, count);
    }
    function drawn() {
      var pixels = new Uint8Array(4 * canvas.width * canvas.height), lit = 0;
      gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
      for (var i = 0; i < pixels.length; i += 4) { lit += pixels[i] > 40 || pixels[i + 1] > 40 || pixels[i + 2] > 40; }
      return lit / (canvas.width * canvas.height);
    }
    function relabel() {
      var reach = +slider.value * cloud.tau, unit = cloud.unit ? " " + cloud.unit : "";
      shown.textContent = (+slider.value).toFixed(2) + " τ";
      ends[1].textContent = "≥ " + parseFloat(reach.toPrecision(3)) + unit;
      draw();
    }
    function load(index) {
      return inflate(bytesOf(document.getElementById("cloud-" + index).textContent.trim())).then(function (planes) {
        var data = points(planes);
        cloud = clouds[index];
        count = data.length / 4;
        fit(data);
        gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
        relabel();
      });
    }
    function nudge(key) {
      var step = 0.08;
      if (key === "ArrowLeft") { yaw -= step; } else if (key === "ArrowRight") { yaw += step; }
      else if (key === "ArrowUp") { pitch = Math.min(1.55, pitch + step); } else if (key === "ArrowDown") { pitch = Math.max(-1.55, pitch - step); }
      else if (key === "+" || key === "=") { distance = Math.max(0.15, distance / 1.1); } else if (key === "-") { distance = Math.min(8, distance * 1.1); }
      else { return false; }
      draw();
      return true;
    }
    canvas.addEventListener("keydown", function (event) { if (nudge(event.key)) { event.preventDefault(); } });
    // Fingers: one turns, two come nearer or go away, and up and down is the page's.
    var fingers = new Map();
    function apart() {
      var at = Array.from(fingers.values());
      return Math.hypot(at[0][0] - at[1][0], at[0][1] - at[1][1]);
    }
    function lift(event) { fingers.delete(event.pointerId); }
    canvas.addEventListener("pointerup", lift);
    canvas.addEventListener("pointercancel", lift);
    canvas.addEventListener("pointerdown", function (event) {
      canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    canvas.addEventListener("pointermove", function (event) {
      if (!event.buttons) { return; }
      var before = fingers.size === 2 ? apart() : 0;
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
      if (fingers.size === 2) {
        distance = Math.max(0.15, Math.min(8, distance * before / Math.max(1, apart())));
        draw();
        return;
      }
      yaw -= event.movementX * 0.008;
      pitch = Math.max(-1.55, Math.min(1.55, pitch + event.movementY * 0.008));
      draw();
    });
    canvas.addEventListener("wheel", function (event) {
      event.preventDefault();
      distance = Math.max(0.15, Math.min(8, distance * Math.exp(event.deltaY * 0.001)));
      draw();
    }, { passive: false });
    function spin() { if (spinning) { yaw += 0.006; draw(); requestAnimationFrame(spin); } }
    turn.addEventListener("click", function () {
      spinning = !spinning;
      turn.setAttribute("aria-pressed", String(spinning));
      spin();
    });
    slider.addEventListener("input", relabel);
    select.addEventListener("change", function () { load(+select.value); });
    window.addEventListener("resize", draw);
    return load(0).then(function () {
      var share = drawn();
      root.dataset.drawn = share.toFixed(4);
      if (share < 0.001) { throw new Error("nothing was drawn"); }
      return "ok";
    });
  }

  var box = document.querySelector(".viewer");
  Promise.resolve(box ? viewer(box) : "ok").then(finish, function (problem) { finish("error: " + problem.message); });
})();
