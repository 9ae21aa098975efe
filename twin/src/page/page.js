// Connection, words and orders.
(() => {
  const $ = id => document.getElementById(id);
  const token = new URLSearchParams(location.hash.slice(1)).get('token');
  // In the playground the robot runs in the page itself.
  const local = typeof Playground !== 'undefined';
  let socket = null, robot = null, live = null, heardAt = 0, may = false, mayStop = false, asked = false, gone = false, refused = '', orders = [], sent = 0, wait = 250;
  const STOPS = ['stop', 'hold'];
  const COLORS = ['--c1', '--c2', '--c3', '--c4', '--accent', '--good', '--warn', '--bad'];
  const color = i => getComputedStyle(document.documentElement).getPropertyValue(COLORS[i % COLORS.length]).trim();
  const mm = (v, d) => (v * 1e3).toFixed(d);
  const text = (id, value) => { const e = $(id); if (e.textContent !== value) e.textContent = value; };
  const waiting = new Map();
  // An order, and its answer: { ok, data, reason }.
  const request = message => new Promise(done => {
    const id = send(message);
    if (id) waiting.set(id, done); else done({ ok: false, reason: 'no connection' });
  });
  // What the server has at a path; a playground has its own.
  async function document_(path) {
    if (local) {
      const answer = await request({ order: 'document', path: decodeURIComponent(path) });
      if (!answer.ok) throw new Error(answer.reason);
      return answer.data;
    }
    const answer = await fetch(path), body = await answer.text();
    if (!answer.ok) throw new Error(body);
    return JSON.parse(body);
  }
  window.mcdpr = { request, document: document_, get robot() { return robot; }, get live() { return live; }, get may() { return may; }, send, get connected() { return !!socket && socket.readyState === 1; }, answers: [] };

  function connect() {
    socket = typeof Playground === 'undefined' ? new WebSocket(`ws://${location.host}/ws`) : new Playground.Line();
    socket.onopen = () => { wait = 250; gone = false; pill('link', local ? 'simulated in this page' : 'connected', 'good'); if (token || local) send({ order: 'may' }); };
    socket.binaryType = 'blob';
    socket.onmessage = event => event.data instanceof Blob ? picture(event.data) : take(JSON.parse(event.data));
    socket.onclose = () => {
      pill('link', 'no connection, trying again', 'bad');
      may = mayStop = asked = false; gone = true; refused = ''; endJog(); jogKeys(false); buttons();
      waiting.forEach(done => done({ ok: false, reason: 'the connection was lost' })); waiting.clear();
      setTimeout(connect, wait); wait = Math.min(2000, wait * 1.5);
    };
  }

  function send(message) {
    if (!socket || socket.readyState !== 1) { text('answer', 'not sent: no connection'); return 0; }
    message.id = ++sent; message.token = token;
    socket.send(JSON.stringify(message));
    return message.id;
  }

  function take(m) {
    if (m.type === 'hello') {
      const other = robot && JSON.stringify(robot) !== JSON.stringify(m.robot);
      robot = m.robot; orders = m.orders;
      text('name', robot.name); document.title = robot.name + ' - MCDPR';
      text('most', robot.tension_max_n.toFixed(0) + ' N');
      Scene.setRobot(robot); Scene.setPlan([]); LiveCharts.setRobot(robot); rows(); buttons();
      for (const o of $('jog-speed').options) o.disabled = o.value * 1e-3 > robot.speed_mps;
      Work.speeds(robot.speed_mps);
      Sim.allow(may, orders, m); Runs.allow(orders);
      // Another robot's file is read again; a mere loss of the connection does not undo what was typed.
      if (other || local) RobotFile.forget();
      if (local) { for (const name of ['setup', 'pick']) $('tab-' + name).hidden = true; $('robot-use').hidden = true; }
    } else if (m.type === 'plan') Scene.setPlan(m.tool_m);
    else if (m.type === 'log') m.lines.forEach(log);
    else if (m.type === 'answer') answer(m);
    else if (m.type === 'live') show(m);
    else if (m.type === 'preview') Work.show(m);
    else if (m.type === 'camera') camera = m;
    else if (m.type === 'steps') { Steps.take(m); buttons(); }
    else if (m.type === 'output') Steps.output(m.lines);
    else if (m.type === 'pick') Pick.take(m);
  }

  // The picture follows the message that states what was found in it.
  let camera = null;
  async function picture(blob) {
    const m = camera;
    if (!m) return;
    const image = await createImageBitmap(blob);
    const canvas = $('picture'), pen = canvas.getContext('2d');
    canvas.width = m.width; canvas.height = m.height;
    pen.drawImage(image, 0, 0);
    const outline = (points, colour) => {
      pen.strokeStyle = colour; pen.lineWidth = Math.max(1.5, m.width / 240);
      pen.beginPath(); points.forEach(([x, y], i) => i ? pen.lineTo(x, y) : pen.moveTo(x, y)); pen.closePath(); pen.stroke();
    };
    pen.font = `bold ${Math.max(9, m.width / 28)}px system-ui, sans-serif`;
    for (const tag of m.tags) {
      outline(tag.corners_px, '#3fe07a');
      const [x, y] = tag.corners_px.reduce((a, b) => a[1] < b[1] ? a : b);
      pen.fillStyle = '#3fe07a'; pen.fillText(`tag ${tag.id}`, x, y - 4);
    }
    if (m.grasp) {
      outline(m.grasp.corners_px, '#ffb020');
      outline(m.grasp.pads_px, '#ffb020');
    }
    const found = m.tags.map(t => `tag ${t.id}`);
    if (m.grasp) found.push(`grasp, ${mm(m.grasp.width_m, 1)} mm wide`);
    text('seen', `${m.source}: ${found.length ? found.join(', ') : 'nothing found'}`);
    $('camera').hidden = false;
    window.mcdpr.pictures = (window.mcdpr.pictures || 0) + 1;
    window.mcdpr.camera = m;
  }

  function answer(m) {
    window.mcdpr.answers.push(m);
    if (m.order === 'may') {
      may = m.ok; mayStop = m.may_stop; asked = true; refused = m.reason || ''; buttons();
      // Another page has the controls: they are taken over when it goes.
      if (!may && mayStop) setTimeout(() => { if (!may && socket.readyState === 1) send({ order: 'may' }); }, 1000);
      return;
    }
    text('answer', m.ok ? '' : `${m.order}: ${m.reason}`);
    const done = waiting.get(m.id);
    if (done) { waiting.delete(m.id); done(m); }
  }

  function show(m) {
    live = m; heardAt = performance.now() - (m.age_s || 0) * 1e3;
    const kind = { Moving: 'move', Pausing: 'warn', Stopping: 'warn', Arming: 'warn', Holding: 'good', Fault: 'bad', EStop: 'bad' }[m.state] || '';
    pill('state', m.state || 'waiting', kind);
    text('words', m.words);
    $('alarm').hidden = !m.fault;
    text('trouble', m.trouble || ''); $('recover').hidden = !(m.trouble || '').includes('mcdpr recover') || !Steps.known;
    if (m.fault) text('alarm', `Fault ${m.fault}. ${m.advice || ''}`);
    text('task', m.task || 'nothing in progress');
    text('time', m.duration_s > 0 ? `${m.path_s.toFixed(1)} of ${m.duration_s.toFixed(1)} s` : '');
    $('progress').value = m.duration_s > 0 ? m.path_s / m.duration_s : 0;
    if (m.pose) {
      const p = m.pose, [x, y, z, w] = p.rotation_xyzw;
      text('tool', p.tool_m.map(v => mm(v, 1)).join(', ') + ' mm');
      const up = 1 - 2 * (x * x + y * y);
      text('tilt', (Math.acos(Math.max(-1, Math.min(1, up))) * 180 / Math.PI).toFixed(1) + '\u00b0');
      text('source', p.source);
    }
    text('error', m.path_error_m === null || m.path_error_m === undefined ? '\u2013' : mm(m.path_error_m, 2) + ' mm');
    const count = robot ? robot.cables.length : 4, open = bits(m.brakes_open);
    text('brakes', open === 0 ? 'closed' : open === count ? 'open' : `${open} of ${count} open`);
    const limits = $('limits'), list = m.limits.join('\n');
    if (limits.dataset.list !== list) {
      limits.dataset.list = list;
      limits.replaceChildren(...m.limits.map(l => Object.assign(document.createElement('li'), { textContent: l })));
    }
    cables(m);
    LiveCharts.live(m);
    Scene.setLive(m);
    Runs.live(m);
  }

  const bits = n => { let c = 0; for (; n; n >>= 1) c += n & 1; return c; };

  function rows() {
    $('cables').replaceChildren(...robot.cables.map((c, i) => {
      const row = document.createElement('tr');
      row.innerHTML = `<td><i class="line" style="background:${color(i)}"></i>${i + 1}${c.tension_held ? ' T' : ''}</td><td></td><td></td><td></td><td class="bar"><div class="meter"><i></i></div></td>`;
      if (c.tension_held) row.title = 'held at a tension; the others are held at a length';
      return row;
    }));
  }

  function cables(m) {
    [...$('cables').children].forEach((row, i) => {
      const cells = row.children, most = robot.cables[i].tension_max_n || robot.tension_max_n;
      const set = (cell, value) => { if (cell.textContent !== value) cell.textContent = value; };
      const n = m.tensions_n[i], l = m.lengths_m[i], e = m.length_errors_m[i];
      set(cells[1], l === undefined ? '\u2013' : mm(l, 1));
      set(cells[2], e === undefined ? '\u2013' : mm(e, 2));
      set(cells[3], n === undefined ? '\u2013' : n.toFixed(1));
      const bar = cells[4].firstChild.firstChild;
      bar.style.width = `${Math.max(0, Math.min(100, 100 * (n || 0) / most))}%`;
      bar.style.background = Scene.heat(n || 0, most);
    });
  }

  function log({ time_s, text: words }) {
    const item = document.createElement('li'), at = document.createElement('time');
    at.textContent = time_s.toFixed(2) + ' s'; item.append(at, words);
    $('log').prepend(item);
    while ($('log').children.length > 60) $('log').lastChild.remove();
  }

  function pill(id, words, kind) { text(id, words); $(id).className = 'pill ' + (kind || 'quiet'); }

  function buttons() {
    document.querySelectorAll('[data-order]').forEach(b => { b.disabled = !(may || mayStop && STOPS.includes(b.dataset.order)) || !orders.includes(b.dataset.order); });
    // A step of set-up has the robot: nothing else is started.
    const start = document.querySelector('[data-order=start]');
    start.disabled ||= !!Steps.busy; start.title = Steps.busy || 'G';
    $('jog').disabled = !may || !!Steps.busy; $('jog').title = Steps.busy;
    if (!may) jogKeys(false);
    RobotFile.allow(may, gone ? 'no connection' : refused || 'view only: orders need the address with the token');
    Steps.allow(may && orders.includes('step_run'), gone ? 'no connection' : refused || 'view only: orders need the address with the token');
    Work.allow(may, orders, gone ? 'no connection' : refused || 'view only: orders need the address with the token');
    text('may', gone ? 'The program that serves this page does not answer: it has ended, or this machine is not reached any more. Trying again. Stop the robot by its emergency stop.'
      : may ? 'Esc stops and Space holds, whatever is selected; R resumes, G starts.' : mayStop ? refused
      : !token ? 'View only: orders need the address with the token that the program printed.'
      : asked ? 'The token is not that of this server: view only.' : '');
  }

  document.querySelectorAll('[data-order]').forEach(b => b.addEventListener('click', () => send({ order: b.dataset.order })));
  // A button keeps no focus: the next key must not press it again.
  document.addEventListener('click', e => { const b = e.target.closest('button'); if (b) b.blur(); });
  // A jog order is valid for a fifth of a second and repeated while a button or a key is held.
  let jogging = null, padVelocity = null;
  const jog = v => send({ order: 'jog', velocity_mps: v.map(c => c * $('jog-speed').value * 1e-3) });
  const beginJog = v => { if (jogging || !may) return; const step = padJogs ? 0 : Number($('jog-step').value); if (step) { Work.step(v.map(c => c * step), Number($('jog-speed').value)); return; } jog(v); jogging = { timer: setInterval(() => jog(padJogs ? padVelocity : v), 80) }; };
  const endJog = () => { if (jogging) { clearInterval(jogging.timer); jogging = null; jog([0, 0, 0]); } };
  document.querySelectorAll('[data-jog]').forEach(b => {
    const v = b.dataset.jog.split(',').map(Number);
    b.addEventListener('pointerdown', () => { if (!b.matches(':disabled')) beginJog(v); });
    for (const end of ['pointerup', 'pointerleave', 'pointercancel', 'blur']) b.addEventListener(end, endJog);
  });
  // Keys jog only after they were switched on, and until Esc, Space or the window's end.
  const JOG_KEYS = { ArrowLeft: [-1, 0, 0], ArrowRight: [1, 0, 0], ArrowDown: [0, -1, 0], ArrowUp: [0, 1, 0], PageDown: [0, 0, -1], PageUp: [0, 0, 1] };
  let keysJog = false, jogKey = null;
  function jogKeys(on) {
    if (!on && jogKey) { jogKey = null; endJog(); }
    keysJog = on;
    $('jog-keys').setAttribute('aria-pressed', on); text('jog-keys', on ? 'Jog by keys: on (Esc ends it)' : 'Jog by keys: off');
  }
  $('jog-keys').addEventListener('click', () => jogKeys(!keysJog && may));
  const letGo = () => { endJog(); jogKeys(false); Work.noStep(); };
  const keyHelp = () => { $('keys').hidden = !$('keys').hidden; $('keys-show').setAttribute('aria-expanded', !$('keys').hidden); };
  $('keys-show').addEventListener('click', keyHelp);
  window.addEventListener('blur', letGo);
  document.addEventListener('visibilitychange', () => { if (document.hidden) letGo(); });
  // Before anything that has the focus: these keys act the same everywhere on the page.
  const ours = e => { e.preventDefault(); e.stopImmediatePropagation(); };
  window.addEventListener('keydown', e => {
    if (e.key === 'Escape') { letGo(); send({ order: 'stop' }); return ours(e); }
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    const typing = e.target.matches && e.target.matches('input, textarea');
    // Space holds wherever the focus is; in a text it also types.
    if (e.key === ' ') { if (!typing) ours(e); if (!e.repeat) { letGo(); if (!typing || live && live.state === 'Moving') send({ order: 'hold' }); } return; }
    if (typing) return;
    if (keysJog && JOG_KEYS[e.key]) { ours(e); if (!e.repeat && !jogKey) { jogKey = e.key; beginJog(JOG_KEYS[e.key]); } return; }
    // Start and Resume let the robot move: a key that is still held from before does not.
    if (e.repeat) return;
    if (e.key === '?') keyHelp();
    else if (e.key === 'r') send({ order: 'resume' });
    else if (e.key === 'g') send({ order: 'start' });
  }, true);
  window.addEventListener('keyup', e => {
    // Some browsers press the focused button when Space is let go.
    if (e.key === ' ' && !(e.target.matches && e.target.matches('input, textarea'))) ours(e);
    if (e.key === jogKey) { jogKey = null; endJog(); ours(e); }
  }, true);

  // A gamepad jogs while its left shoulder button is held: the left stick moves x and y, the right one z.
  let padJogs = false;
  function gamepad() {
    const pad = [...(navigator.getGamepads ? navigator.getGamepads() : [])].find(p => p && p.buttons.length > 4);
    if (!pad || !may || !pad.buttons[4].pressed) { if (padJogs) { padJogs = false; endJog(); } return; }
    const dead = v => Math.abs(v || 0) < 0.15 ? 0 : v;
    const v = [dead(pad.axes[0]), -dead(pad.axes[1]), -dead(pad.axes[3])], n = Math.hypot(...v);
    const now = n > 1 ? v.map(c => c / n) : v;
    if (n === 0) { if (padJogs) { padJogs = false; endJog(); } return; }
    if (!padJogs && !jogging) { padJogs = true; beginJog(now); }
    padVelocity = now;
  }

  function frame() {
    const age = live ? (performance.now() - heardAt) / 1e3 : Infinity, old = age > 0.5;
    document.body.classList.toggle('old', old);
    $('stale').hidden = !old;
    if (old) text('stale', live && Number.isFinite(age) && live.age_s !== null ? `old data: ${age.toFixed(1)} s` : 'no data yet');
    Scene.draw();
    gamepad();
    LiveCharts.draw(performance.now());
    requestAnimationFrame(frame);
  }

  const tab = name => {
    letGo();
    document.querySelectorAll('[data-tab]').forEach(b => {
      b.setAttribute('aria-selected', b.dataset.tab === name); $(b.dataset.tab).hidden = b.dataset.tab !== name;
    });
    if (name === 'runs') Runs.list();
    if (name === 'robot') RobotFile.open();
    if (name === 'setup' || name === 'pick') Steps.open();
  };
  document.querySelectorAll('[data-tab]').forEach(b => b.addEventListener('click', () => tab(b.dataset.tab)));
  $('recover').addEventListener('click', () => { tab('setup'); Steps.go('recover'); });
  Scene.bind($('scene')); Scene.theme();
  window.matchMedia('(prefers-color-scheme: light)').addEventListener('change', Scene.theme);
  // The rest of the page is there when this runs.
  window.addEventListener('DOMContentLoaded', () => { buttons(); connect(); requestAnimationFrame(frame); });
})();
