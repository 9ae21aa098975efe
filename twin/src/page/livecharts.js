// Charts of the last minute: what the robot measures now. They follow the time until somebody zooms.
const LiveCharts = (() => {
  const $ = id => document.getElementById(id);
  const KEPT = 60, SPAN = 20, PERIOD = 50;
  const box = $('live-charts'), KINDS = ['tensions', 'errors', 'currents', 'path'];
  const TITLES = { tensions: 'Tensions', errors: 'Length errors', currents: 'Motor currents', path: 'Path error' };
  let robot = null, plots = {}, shown = ['tensions', 'errors'], range = null, cursor = null, drawn = 0;
  let times = [], rows = [];
  try { const old = JSON.parse(localStorage.getItem('mcdpr-charts')); if (Array.isArray(old)) shown = KINDS.filter(k => old.includes(k)); } catch { /* a browser that keeps nothing */ }

  function setRobot(description) {
    robot = description; times = []; rows = [];
    $('live-choice').replaceChildren(...KINDS.map(kind => {
      const label = document.createElement('label'), tick = Object.assign(document.createElement('input'), { type: 'checkbox', id: `see-${kind}`, checked: shown.includes(kind) });
      tick.addEventListener('change', () => choose(kind, tick.checked));
      label.append(tick, TITLES[kind]);
      return label;
    }));
    build();
  }

  function choose(kind, on) {
    shown = KINDS.filter(k => k === kind ? on : shown.includes(k));
    try { localStorage.setItem('mcdpr-charts', JSON.stringify(shown)); } catch { /* as above */ }
    build();
  }

  const held = () => robot.cables.map((c, i) => c.tension_held ? i : -1).filter(i => i >= 0);
  // The planned set-point of a held cable: that of the motion, at rest the robot file's.
  const setpoint = (m, i) => m.expected_n.length > i ? m.expected_n[i] : robot.setpoint_n;

  function build() {
    Object.values(plots).forEach(chart => chart.remove());
    plots = {};
    const cables = robot.cables.map((_, i) => ({ name: String(i + 1), color: i }));
    const spec = (title, unit, digits, lines, more) => ({ title, unit, digits, lines, onView: view, onCursor: move, reset, ...more });
    const wanted = held().map(i => ({ name: `${i + 1} planned`, color: i, dashed: true })), n = cables.length;
    const edges = wanted.length ? [{ hidden: true, color: 3, name: '' }, { hidden: true, color: 3, name: '' }] : [];
    const specs = {
      tensions: spec('Tensions', 'N', 2, [...cables, ...wanted, ...edges], { band: wanted.length ? [n + wanted.length, n + wanted.length + 1] : null, least: 1, limits: () => [robot.tension_min_n, robot.tension_max_n] }),
      errors: spec('Length errors', 'mm', 3, cables, { least: 0.02 }),
      currents: spec('Motor currents', 'A', 2, cables, { least: 0.02 }),
      path: spec('Path error', 'mm', 3, [{ name: 'error', color: 0 }], { least: 0.02 }),
    };
    for (const kind of shown) { plots[kind] = Charts.create(specs[kind]); box.append(plots[kind].figure); }
    drawn = 0;
  }

  const values = m => ({
    tensions: [...robot.cables.map((_, i) => m.tensions_n[i]), ...held().map(i => setpoint(m, i)), ...held().slice(0, 1).flatMap(i => [setpoint(m, i) - 0.5, setpoint(m, i) + 0.5])],
    errors: robot.cables.map((_, i) => m.length_errors_m[i] * 1e3),
    currents: robot.cables.map((_, i) => m.currents_a[i]),
    path: [m.path_error_m === null || m.path_error_m === undefined ? null : m.path_error_m * 1e3],
  });

  function live(m) {
    if (!robot) return;
    const last = times[times.length - 1];
    if (last !== undefined && m.time_s < last) { times = []; rows = []; reset(); }
    // Every message is kept: several of one instant are one.
    if (m.time_s === last) rows[rows.length - 1] = values(m); else { times.push(m.time_s); rows.push(values(m)); }
    while (times[0] < m.time_s - KEPT) { times.shift(); rows.shift(); }
  }

  // Called for every picture of the page; twenty drawings a second are enough for charts.
  function draw(now) {
    if (!robot || now - drawn < PERIOD || !times.length || document.body.classList.contains('past')) return;
    drawn = now;
    const end = times[times.length - 1], [from, to] = range || [end - SPAN, end];
    // What lies outside is not drawn.
    const first = Math.max(0, Charts.nearest(times, from) - 1), last = Math.min(times.length, Charts.nearest(times, to) + 2);
    const some = times.slice(first, last), part = rows.slice(first, last);
    for (const kind in plots) {
      const count = part.length ? part[0][kind].length : 0;
      const lines = Array.from({ length: count }, (_, i) => [part.map(row => Number.isFinite(row[kind][i]) ? row[kind][i] : null)]);
      plots[kind].set(some, lines); plots[kind].view(from, to);
    }
  }

  function view(from, to) {
    const end = times[times.length - 1] || 0, width = Math.max(0.1, Math.min(to - from, KEPT));
    range = [Math.min(from, end - 0.1), Math.min(from, end - 0.1) + width]; drawn = 0;
    $('live-follow').hidden = false;
  }
  function reset() { range = null; drawn = 0; $('live-follow').hidden = true; }
  function move(at) { cursor = at; for (const kind in plots) plots[kind].cursor(at); }
  $('live-follow').addEventListener('click', reset);

  return {
    setRobot, live, draw, choose,
    get range() { return range; }, get shown() { return shown; }, chart: kind => plots[kind],
    // The band of the tension chart at the last instant: set-point -+0.5 N.
    get band() { const row = rows[rows.length - 1]; return row && held().length ? row.tensions.slice(-2) : null; },
  };
})();
window.mcdpr.liveCharts = LiveCharts;
