// Picking: its phase, the tray with what is in it in the drawing, the chosen grasp, and why others are refused.
const Pick = (() => {
  const $ = id => document.getElementById(id);
  const text = (id, value) => { const e = $(id); if (e.textContent !== value) e.textContent = value; };
  const PHASES = { preparing: 'prepare', looking: 'look', choosing: 'choose', looking_again: 'look again', approaching: 'approach', descending: 'descend', closing: 'close', lifting: 'lift and weigh', carrying: 'carry', releasing: 'release', returning: 'return' };
  const seen = new Set();
  let now = null;

  function things(m) {
    const list = [];
    if (m.tray) {
      const [x, y, z] = m.tray.middle_m, [hx, hy] = m.tray.half_m;
      list.push({ points: [[x - hx, y - hy, z], [x + hx, y - hy, z], [x + hx, y + hy, z], [x - hx, y + hy, z]], fill: 'edge', line: 'text', closed: true });
      const [rx, ry, rz] = m.tray.release_m, r = 0.012;
      list.push({ points: [[rx - r, ry, rz], [rx + r, ry, rz]], line: 'good' }, { points: [[rx, ry - r, rz], [rx, ry + r, rz]], line: 'good' });
    }
    for (const o of m.objects || []) {
      const n = o.low_m.length;
      list.push({ points: o.low_m, fill: 'plan', line: 'text', closed: true });
      for (let i = 0; i < n; i++) list.push({ points: [o.low_m[i], o.low_m[(i + 1) % n], o.high_m[(i + 1) % n], o.high_m[i]], fill: 'plan', line: n > 4 ? 'plan' : 'text', closed: true });
      list.push({ points: o.high_m, fill: 'accent', line: 'text', closed: true });
    }
    for (const g of m.refused || []) list.push({ dot: g.at_m, line: 'bad' });
    if (m.chosen) list.push({ points: m.chosen.pads_m, line: 'good', width: 4 }, { dot: m.chosen.tool_m, line: 'good' });
    return list;
  }

  function take(m) {
    now = m;
    if (!m.phase) { seen.clear(); $('pick-live').hidden = true; Scene.setThings([]); return; }
    $('pick-live').hidden = false;
    for (const phase of m.phases || []) seen.add(phase);
    $('pick-phases').replaceChildren(...Object.entries(PHASES).map(([id, words]) => {
      const item = Object.assign(document.createElement('li'), { textContent: words, className: id === m.phase ? 'now' : seen.has(id) ? 'was' : '' });
      if (id === m.phase) item.setAttribute('aria-current', 'step');
      return item;
    }));
    // 9.80665 m/s2 turns the weight of an object into its mass.
    const weight = n => `${n.toFixed(2)} N (${(n / 9.80665 * 1e3).toFixed(0)} g)`;
    text('pick-weight', Number.isFinite(m.weight_n) ? `Lifted: ${weight(m.weight_n)}` : '');
    $('pick-attempts').replaceChildren(...(m.attempts || []).map(a =>
      Object.assign(document.createElement('li'), { textContent: a.outcome + (Number.isFinite(a.weight_n) ? `, weighed ${weight(a.weight_n)}` : ', nothing lifted') })));
    text('pick-count', `${m.picked} picked, ${m.failed} failed` + (m.end ? `; ${m.end}` : ''));
    const mm = v => (v * 1e3).toFixed(1), c = m.chosen;
    text('pick-chosen', c ? `Grasp at ${c.tool_m.map(mm).join(', ')} mm, ${mm(c.width_m)} mm wide, tool tilted by ${(c.tilt_rad * 180 / Math.PI).toFixed(1)}\u00b0, rank ${c.rank.toFixed(2)}`
      : m.grasps === undefined ? '' : `${m.grasps} grasps found, ${m.possible} possible`);
    // Grasps with the same reason are counted.
    const reasons = new Map();
    for (const g of m.refused || []) reasons.set(g.reason, [...(reasons.get(g.reason) || []), g]);
    $('pick-refused').replaceChildren(...[...reasons].sort((a, b) => b[1].length - a[1].length).map(([reason, all]) =>
      Object.assign(document.createElement('li'), { textContent: `${all.length} \u00d7 ${reason}`, title: all.slice(0, 5).map(g => g.at_m.map(mm).join(', ') + ' mm').join('; ') })));
    text('pick-none', m.refused && m.refused.length ? '' : 'none refused so far');
    Scene.setThings(things(m));
  }

  return { take, get now() { return now; }, get seen() { return [...seen]; } };
})();
window.mcdpr.pick = Pick;
