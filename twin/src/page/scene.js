'use strict';
// The robot in three dimensions on a 2-D canvas: few lines, drawn back to front.
const Scene = (() => {
  const home = { yaw: 0.55, pitch: 0.4, zoom: 1.12 };
  let eye = { ...home }, robot = null, plan = [], next = [], things = [], trace = [], picked = null, pose = null, live = null, dirty = true, drag = null;
  // What the robot does now; it is drawn unless a recorded run is.
  const now = { plan: [], trace: [], pose: null, live: null };
  let past = null;
  let canvas, pen, colors = {};
  let middle = [0, 0, 0], size = 1, low = 0;

  const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
  const mul = (a, k) => [a[0] * k, a[1] * k, a[2] * k];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const norm = a => Math.hypot(a[0], a[1], a[2]);
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  // Rotates by a unit quaternion [x, y, z, w].
  const turn = ([x, y, z, w], v) => {
    const t = mul(cross([x, y, z], v), 2);
    return add(add(v, mul(t, w)), cross([x, y, z], t));
  };

  function project(p) {
    const q = sub(p, middle), c = Math.cos(eye.yaw), s = Math.sin(eye.yaw);
    const x = q[0] * c + q[1] * s, y = -q[0] * s + q[1] * c, z = q[2];
    const cp = Math.cos(eye.pitch), sp = Math.sin(eye.pitch);
    const depth = y * cp - z * sp, up = y * sp + z * cp;
    const far = 3.2 * size, k = far / (far + depth);
    const unit = Math.min(canvas.width, canvas.height * 1.25) / (1.75 * size) * eye.zoom;
    return [canvas.width / 2 + x * k * unit, canvas.height * 0.47 - up * k * unit, depth, k * unit];
  }

  function line(points, color, width, dash) {
    if (points.length < 2) return;
    pen.beginPath();
    points.forEach((p, i) => { const q = project(p); i ? pen.lineTo(q[0], q[1]) : pen.moveTo(q[0], q[1]); });
    pen.strokeStyle = color; pen.lineWidth = width * (window.devicePixelRatio || 1);
    pen.setLineDash(dash || []); pen.lineJoin = pen.lineCap = 'round'; pen.stroke(); pen.setLineDash([]);
  }

  function face(points, color, edge) {
    pen.beginPath();
    points.forEach((p, i) => { const q = project(p); i ? pen.lineTo(q[0], q[1]) : pen.moveTo(q[0], q[1]); });
    pen.closePath(); pen.fillStyle = color; pen.fill();
    pen.strokeStyle = edge; pen.lineWidth = window.devicePixelRatio || 1; pen.stroke();
  }

  const dotAt = (p, r, color) => {
    const q = project(p);
    pen.beginPath(); pen.arc(q[0], q[1], Math.max(2, r * q[3]), 0, 7); pen.fillStyle = color; pen.fill();
  };

  // Blue at no tension, green in the middle, red at the limit.
  function heat(tension, most) {
    const s = Math.max(0, Math.min(1, tension / (most || 40)));
    const hue = s < 0.5 ? 210 - s * 160 : 130 - (s - 0.5) * 260;
    return `hsl(${hue} 85% 52%)`;
  }

  // The way of a cable over its swivelling pulley: arc, then tangent to the attachment.
  function route(cable, to) {
    const b = cable.anchor_m, a = cable.axis, r = cable.pulley_radius_m;
    const d = sub(to, b), h = dot(d, a), side = sub(d, mul(a, h)), rho = norm(side);
    if (r <= 0 || rho < 1e-6) return [b, to];
    const e = mul(side, 1 / rho), s2 = (rho - r) ** 2 + h * h - r * r;
    if (s2 <= 0) return [b, to];
    let theta = Math.PI - Math.atan2(Math.sqrt(s2), r) - Math.atan2(h, rho - r);
    theta = (theta + 4 * Math.PI) % (2 * Math.PI);
    const center = add(b, mul(e, r)), points = [];
    for (let i = 0; i <= 10; i++) {
      const t = theta * i / 10;
      points.push(add(center, add(mul(e, -r * Math.cos(t)), mul(a, r * Math.sin(t)))));
    }
    points.push(to);
    return points;
  }

  function pulley(cable, to) {
    const r = cable.pulley_radius_m, a = cable.axis, d = sub(to, cable.anchor_m);
    const side = sub(d, mul(a, dot(d, a))), rho = norm(side);
    if (r <= 0 || rho < 1e-6) { dotAt(cable.anchor_m, 0.006, colors.dim); return; }
    const e = mul(side, 1 / rho), center = add(cable.anchor_m, mul(e, r)), ring = [];
    for (let i = 0; i <= 24; i++) {
      const t = i / 24 * 2 * Math.PI;
      ring.push(add(center, add(mul(e, r * Math.cos(t)), mul(a, r * Math.sin(t)))));
    }
    face(ring, colors.card, colors.text);
  }

  function draw() {
    const scale = window.devicePixelRatio || 1;
    const w = Math.round(canvas.clientWidth * scale), h = Math.round(canvas.clientHeight * scale);
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; dirty = true; }
    if (!dirty || !robot) return;
    dirty = false;
    pen.clearRect(0, 0, w, h);
    const anchors = robot.cables.map(c => c.anchor_m);
    const xs = anchors.map(a => a[0]), ys = anchors.map(a => a[1]);
    const x0 = Math.min(...xs), x1 = Math.max(...xs), y0 = Math.min(...ys), y1 = Math.max(...ys);
    const top = Math.max(...anchors.map(a => a[2]));
    // Floor, every 100 mm.
    const step = 0.1, from = v => Math.ceil(v / step) * step;
    for (let x = from(x0); x <= x1 + 1e-9; x += step) line([[x, y0, low], [x, y1, low]], colors.edge, 1);
    for (let y = from(y0); y <= y1 + 1e-9; y += step) line([[x0, y, low], [x1, y, low]], colors.edge, 1);
    // Frame.
    const corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
    corners.forEach(([x, y]) => line([[x, y, low], [x, y, top]], colors.plan, 2));
    line([...corners, corners[0]].map(([x, y]) => [x, y, top]), colors.plan, 2);
    line([...corners, corners[0]].map(([x, y]) => [x, y, low]), colors.edge, 1);
    // Axes at the world's origin, 100 mm.
    const tip = (axis, color, name) => {
      line([[0, 0, low], add([0, 0, low], mul(axis, 0.1))], color, 2);
      const q = project(add([0, 0, low], mul(axis, 0.115)));
      pen.fillStyle = color; pen.font = `${12 * scale}px system-ui, sans-serif`;
      pen.fillText(name, q[0] - 4 * scale, q[1] + 4 * scale);
    };
    tip([1, 0, 0], colors.bad, 'x'); tip([0, 1, 0], colors.good, 'y'); tip([0, 0, 1], colors.accent, 'z');
    line(plan, colors.plan, 2, [5 * scale, 4 * scale]);
    line(next, colors.accent, 2.5, [2 * scale, 5 * scale]);
    if (next.length) dotAt(next[next.length - 1], 0.008, colors.accent);
    line(trace, colors.trace, 2.5);
    const farness = t => t.points && t.fill ? t.points.reduce((s, p) => s + project(p)[2], 0) / t.points.length : -1e9;
    // The first face is what the others stand on.
    [...things.slice(0, 1), ...things.slice(1).sort((a, b) => farness(b) - farness(a))].forEach(t => {
      if (t.dot) dotAt(t.dot, 0.004, colors[t.line]);
      else if (t.fill) face(t.points, colors[t.fill], colors[t.line]);
      else line(t.points, colors[t.line], t.width || 2);
    });
    if (!pose) { anchors.forEach(a => dotAt(a, 0.01, colors.dim)); return; }
    const at = m => add(pose.position_m, turn(pose.rotation_xyzw, m));
    // Shadow of the tool on the floor.
    const tool = pose.tool_m;
    line([tool, [tool[0], tool[1], low]], colors.edge, 1, [3 * scale, 4 * scale]);
    dotAt([tool[0], tool[1], low], 0.008, colors.edge);
    const ends = robot.cables.map(c => at(c.attachment_m));
    const order = robot.cables.map((c, i) => i)
      .sort((a, b) => project(mul(add(ends[b], anchors[b]), 0.5))[2] - project(mul(add(ends[a], anchors[a]), 0.5))[2]);
    const cable = i => {
      const c = robot.cables[i], most = c.tension_max_n || robot.tension_max_n;
      const tension = live && live.tensions_n[i] !== undefined ? live.tensions_n[i] : 0;
      line(route(c, ends[i]), heat(tension, most), 3);
      pulley(c, ends[i]);
      const q = project(c.anchor_m);
      pen.fillStyle = colors.text; pen.font = `600 ${13 * scale}px system-ui, sans-serif`;
      pen.fillText(String(i + 1), q[0] - 4 * scale, q[1] - 12 * scale);
    };
    const behind = project(pose.position_m)[2];
    const far = i => project(anchors[i])[2] > behind;
    order.filter(far).forEach(cable);
    platform(at);
    order.filter(i => !far(i)).forEach(cable);
  }

  // A box through the attachments, shaded by how it faces the viewer, and the tool below it.
  function platform(at) {
    const ms = robot.cables.map(c => c.attachment_m);
    const hx = Math.max(0.03, ...ms.map(m => Math.abs(m[0]))), hy = Math.max(0.03, ...ms.map(m => Math.abs(m[1])));
    const zs = ms.map(m => m[2]), z1 = Math.max(...zs), z0 = Math.min(z1 - 0.04, ...zs);
    const v = [[-hx, -hy, z0], [hx, -hy, z0], [hx, hy, z0], [-hx, hy, z0], [-hx, -hy, z1], [hx, -hy, z1], [hx, hy, z1], [-hx, hy, z1]].map(at);
    line([at([0, 0, z0]), pose.tool_m], colors.text, 3);
    dotAt(pose.tool_m, 0.007, colors.trace);
    const faces = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]];
    const light = [0.35, -0.5, 0.8];
    faces.map(f => {
      const p = f.map(i => v[i]), n = cross(sub(p[1], p[0]), sub(p[2], p[0]));
      const k = dot(n, light) / (norm(n) * norm(light) || 1);
      return { p, depth: f.reduce((s, i) => s + project(v[i])[2], 0) / 4, k };
    }).sort((a, b) => b.depth - a.depth)
      .forEach(f => face(f.p, `hsl(212 22% ${46 + 22 * f.k}%)`, 'rgba(0,0,0,.45)'));
    ms.forEach(m => dotAt(at(m), 0.005, colors.text));
  }

  // The point at height z (m) under a point of the drawing (CSS pixels); null above the horizon.
  function pointAt(px, py, z) {
    const scale = window.devicePixelRatio || 1;
    const unit = Math.min(canvas.width, canvas.height * 1.25) / (1.75 * size) * eye.zoom, far = 3.2 * size;
    const sx = (px * scale - canvas.width / 2) / unit, sy = (canvas.height * 0.47 - py * scale) / unit;
    const qz = z - middle[2], cp = Math.cos(eye.pitch), sp = Math.sin(eye.pitch);
    const under = sp * far - sy * cp;
    if (Math.abs(under) < 1e-9) return null;
    const y = (sy * (far - qz * sp) - qz * cp * far) / under, depth = y * cp - qz * sp;
    if (far + depth <= 0) return null;
    const x = sx * (far + depth) / far, c = Math.cos(eye.yaw), s = Math.sin(eye.yaw);
    return [middle[0] + x * c - y * s, middle[1] + x * s + y * c, z];
  }

  function bind(element) {
    canvas = element; pen = canvas.getContext('2d');
    let last = null, began = null, dragged = false;
    const under = e => { const box = canvas.getBoundingClientRect(); return z => pointAt(e.clientX - box.left, e.clientY - box.top, z); };
    canvas.addEventListener('pointerdown', e => {
      last = [e.clientX, e.clientY];
      // The place that was aimed at: the page can move until the button is let go.
      const box = canvas.getBoundingClientRect();
      began = { x: e.clientX, y: e.clientY, in: [e.clientX - box.left, e.clientY - box.top] };
      canvas.setPointerCapture(e.pointerId);
      dragged = !!drag && drag.begin(under(e));
    });
    canvas.addEventListener('pointerup', e => {
      const from = began && Math.hypot(e.clientX - began.x, e.clientY - began.y) < 4 && began.in;
      last = began = null;
      if (dragged) { dragged = false; drag.end(); return; }
      if (picked && from) picked(z => pointAt(...from, z));
    });
    canvas.addEventListener('pointermove', e => {
      if (!last) return;
      if (dragged) { drag.move(under(e)); return; }
      eye.yaw += (e.clientX - last[0]) * 0.008;
      eye.pitch = Math.max(-0.2, Math.min(1.5, eye.pitch + (e.clientY - last[1]) * 0.008));
      last = [e.clientX, e.clientY]; dirty = true;
    });
    canvas.addEventListener('wheel', e => { zoom(Math.exp(-e.deltaY * 0.001)); e.preventDefault(); }, { passive: false });
    canvas.addEventListener('keydown', e => {
      const turns = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[e.key];
      if (turns) { eye.yaw += turns[0]; eye.pitch = Math.max(-0.2, Math.min(1.5, eye.pitch + turns[1])); }
      else if (e.key === '+') zoom(1.15);
      else if (e.key === '-') zoom(1 / 1.15);
      else if (e.key === '0') eye = { ...home };
      else return;
      dirty = true; e.preventDefault();
    });
  }
  const zoom = k => { eye.zoom = Math.max(0.4, Math.min(6, eye.zoom * k)); dirty = true; };

  function setRobot(description) {
    robot = description;
    const anchors = robot.cables.map(c => c.anchor_m);
    const lo = [0, 1, 2].map(i => Math.min(...anchors.map(a => a[i]))), hi = [0, 1, 2].map(i => Math.max(...anchors.map(a => a[i])));
    size = Math.max(hi[0] - lo[0], hi[1] - lo[1], 0.3);
    low = lo[2] > hi[2] - 0.3 ? lo[2] - 0.75 * size : lo[2];
    middle = [(lo[0] + hi[0]) / 2, (lo[1] + hi[1]) / 2, (low + hi[2]) / 2];
    dirty = true;
  }

  function theme() {
    const style = getComputedStyle(document.documentElement);
    for (const name of ['edge', 'plan', 'trace', 'text', 'dim', 'card', 'bad', 'good', 'accent'])
      colors[name] = style.getPropertyValue('--' + name).trim();
    dirty = true;
  }

  function drawn() { ({ plan, trace, pose, live } = past || now); dirty = true; }

  return {
    bind, draw, setRobot, theme, heat,
    // What to do with a click: gets a function from height to the point there.
    onPick(then) { picked = then; },
    // What to do with a drag instead of turning the drawing, if `begin` takes it.
    onDrag(then) { drag = then; },
    pointAt, project: p => project(p).slice(0, 2).map(v => v / (window.devicePixelRatio || 1)),
    // Lines, faces and dots of a task: points or dot, line and fill by the name of a colour, closed, width.
    setThings(list) { things = list; dirty = true; },
    setNext(points) { next = points; dirty = true; },
    setPlan(points) { now.plan = points; now.trace = []; drawn(); },
    setLive(message) {
      now.live = message;
      if (message.pose) {
        now.pose = message.pose;
        const last = now.trace[now.trace.length - 1];
        if (!last || norm(sub(last, now.pose.tool_m)) > 5e-4) { now.trace.push(now.pose.tool_m); if (now.trace.length > 1500) now.trace.shift(); }
      }
      drawn();
    },
    // An instant of a recorded run: plan, trace, pose, live (tensions). Null shows the robot again.
    setPast(instant) { past = instant; drawn(); },
    get past() { return past; },
  };
})();
