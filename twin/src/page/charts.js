// One chart over time: lines with bands between least and greatest, zoom by wheel, drag, keys and two fingers, a cursor
// with values. Whoever owns it decides which times are shown (`onView`) and what the cursor means (`onCursor`).
const Charts = (() => {
  const COLORS = ['--c1', '--c2', '--c3', '--c4', '--accent', '--good', '--warn', '--bad'];
  const all = new Set();
  let colors = {};
  function theme() {
    const style = getComputedStyle(document.documentElement);
    for (const name of [...COLORS, '--dim', '--edge', '--text']) colors[name] = style.getPropertyValue(name).trim();
    all.forEach(chart => chart.u.redraw(false));
  }
  const color = i => colors[COLORS[i % COLORS.length]];
  const show = (v, digits) => v === null || v === undefined || !Number.isFinite(v) ? '\u2013' : v.toFixed(digits);

  // The index of the time nearest to another one.
  function nearest(times, at) {
    let low = 0, high = times.length - 1;
    while (low < high) { const middle = (low + high) >> 1; if (times[middle] < at) low = middle + 1; else high = middle; }
    return low > 0 && at - times[low - 1] < times[low] - at ? low - 1 : low;
  }

  // spec: title, unit, digits, lines [{ name, color, dashed }], band [index of its lower line, of its upper one],
  // limits() [numbers], onView(from, to), onCursor(at or null), reset().
  function create(spec) {
    const figure = document.createElement('figure'), head = document.createElement('figcaption'), words = document.createElement('output');
    head.append(`${spec.title}, ${spec.unit}`); words.className = 'values';
    const host = Object.assign(document.createElement('div'), { className: 'plot', tabIndex: 0 });
    host.setAttribute('role', 'img');
    host.setAttribute('aria-label', `${spec.title}. Plus and minus zoom, arrows move the cursor, Shift and arrows the part, 0 shows all.`);
    figure.append(head, words, host);
    // Each line has its least and its greatest; both are the sample itself where nothing was left out.
    const series = [{}], bands = [];
    spec.lines.forEach((line, i) => {
      const ends = { stroke: () => line.hidden ? 'transparent' : color(line.color), width: line.dashed ? 1 : 1.4, dash: line.dashed ? [5, 4] : undefined, points: { show: false }, spanGaps: false };
      series.push({ ...ends }, { ...ends });
      if (!line.hidden) bands.push({ series: [2 * i + 2, 2 * i + 1], fill: () => color(line.color) + '55' });
    });
    if (spec.band) bands.push({ series: [2 * spec.band[1] + 2, 2 * spec.band[0] + 1], fill: () => color(3) + '30' });
    let range = [0, 1], at = null, own = false, values = spec.lines.map(() => [[], []]), times = [], begun = null, fingers = new Map();
    const axis = { stroke: () => colors['--dim'], font: '11px system-ui, sans-serif', grid: { stroke: () => colors['--edge'], width: 1 }, ticks: { show: false } };
    const u = new uPlot({
      width: 300, height: 150, pxAlign: 0, series, bands,
      legend: { show: false }, cursor: { y: false, points: { show: false }, drag: { x: true, y: false, setScale: false, dist: 5 } },
      scales: { x: { time: false, auto: false, range: () => range }, y: { range: (_, low, high) => {
        if (low === null || low === undefined || !Number.isFinite(low)) return [0, 1];
        const room = Math.max((high - low) * 0.08, spec.least || 1e-3);
        return [low - room, high + room];
      } } },
      axes: [{ ...axis, size: 24, gap: 2, values: (_, splits, a, b, step) => splits.map(v => v.toFixed(step < 0.01 ? 3 : step < 0.1 ? 2 : step < 1 ? 1 : 0) + ' s') },
        { ...axis, size: 52, gap: 3 }],
      hooks: {
        setSelect: [u => {
          const { left, width } = u.select;
          if (width > 4) spec.onView(u.posToVal(left, 'x'), u.posToVal(left + width, 'x'));
          u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
        }],
        // A pointer on this chart, not a cursor that was set from elsewhere.
        setCursor: [u => {
          if (own || !host.matches(':hover')) return;
          spec.onCursor(u.cursor.left >= 0 ? u.posToVal(u.cursor.left, 'x') : null);
        }],
        drawAxes: [u => limits(u)],
      },
    }, [[], ...spec.lines.flatMap(() => [[], []])], host);

    function limits(u) {
      const pen = u.ctx, { left, width, top, height } = u.bbox;
      pen.save(); pen.strokeStyle = color(7); pen.lineWidth = devicePixelRatio; pen.setLineDash([2, 4]);
      for (const value of spec.limits ? spec.limits() : []) {
        const y = u.valToPos(value, 'y', true);
        if (y < top || y > top + height) continue;
        pen.beginPath(); pen.moveTo(left, y); pen.lineTo(left + width, y); pen.stroke();
      }
      pen.restore();
    }

    function zoom(by, about) {
      const middle = about === undefined || about === null ? at !== null && at > range[0] && at < range[1] ? at : 0.5 * (range[0] + range[1]) : about;
      spec.onView(middle - (middle - range[0]) * by, middle + (range[1] - middle) * by);
    }
    const pan = share => { const by = (range[1] - range[0]) * share; spec.onView(range[0] + by, range[1] + by); };
    const place = e => { const b = u.over.getBoundingClientRect(); return u.posToVal(e.clientX - b.left, 'x'); };
    u.over.addEventListener('wheel', e => { e.preventDefault(); zoom(Math.exp(Math.max(-1, Math.min(1, e.deltaY * 0.002))), place(e)); }, { passive: false });
    u.over.addEventListener('dblclick', () => spec.reset());
    // Fingers: one moves the cursor, two zoom and move the part between them.
    u.over.addEventListener('pointerdown', e => { if (e.pointerType === 'touch') { fingers.set(e.pointerId, e); begun = null; } });
    u.over.addEventListener('pointermove', e => {
      if (!fingers.has(e.pointerId)) return;
      fingers.set(e.pointerId, e);
      if (fingers.size === 1) { spec.onCursor(place(e)); return; }
      const b = u.over.getBoundingClientRect(), [x0, x1] = [...fingers.values()].map(f => (f.clientX - b.left) / b.width).sort((p, q) => p - q);
      const [from, to] = range, width = to - from;
      if (!begun) { begun = [from + x0 * width, from + x1 * width]; return; }
      const scale = (begun[1] - begun[0]) / Math.max(0.05, x1 - x0);
      spec.onView(begun[0] - x0 * scale, begun[0] + (1 - x0) * scale);
    });
    for (const end of ['pointerup', 'pointercancel', 'pointerleave']) u.over.addEventListener(end, e => { fingers.delete(e.pointerId); begun = null; });
    host.addEventListener('keydown', e => {
      if (e.ctrlKey || e.metaKey || e.altKey) return;
      const side = { ArrowLeft: -1, ArrowRight: 1 }[e.key];
      if (side && e.shiftKey) pan(0.2 * side);
      else if (side) spec.onCursor(Math.max(range[0], Math.min(range[1], (at === null ? 0.5 * (range[0] + range[1]) : at) + side * (range[1] - range[0]) / 100)));
      else if (e.key === '+' || e.key === '=') zoom(0.5);
      else if (e.key === '-') zoom(2);
      else if (e.key === '0') spec.reset();
      else return;
      e.preventDefault();
    });
    const chart = {
      u, figure, host,
      get range() { return range; },
      // Times and, for each line, its least and greatest values (the same list if nothing was left out).
      set(newTimes, newValues) {
        times = newTimes; values = newValues;
        u.setData([times, ...values.flatMap(([low, high]) => [low, high || low])], false);
        chart.view(...range);
      },
      view(from, to) { range = [from, to]; u.setScale('x', { min: from, max: to }); chart.cursor(at); },
      cursor(time) {
        at = time;
        own = true; u.setCursor(time === null || time < range[0] || time > range[1] ? { left: -10, top: -10 } : { left: u.valToPos(time, 'x'), top: 0 }); own = false;
        words.textContent = words.title = chart.text();
      },
      // The values at the cursor, without one the last ones.
      at() {
        const i = at === null ? times.length - 1 : nearest(times, at);
        return { time: times[i], lines: values.map(([low, high]) => [low[i], (high || low)[i]]) };
      },
      text() {
        if (!times.length) return 'no data';
        const now = chart.at();
        const one = (line, [low, high]) => line.hidden ? [] : `${line.name} ${show(low, spec.digits)}${high !== low && high !== null ? ' to ' + show(high, spec.digits) : ''}`;
        return (at === null ? '' : `${now.time.toFixed(3)} s: `) + spec.lines.flatMap((line, i) => one(line, now.lines[i])).join('; ');
      },
      remove() { all.delete(chart); size.disconnect(); u.destroy(); figure.remove(); },
    };
    const size = new ResizeObserver(() => { const w = Math.floor(host.clientWidth), h = Math.floor(host.clientHeight); if (w > 60 && h > 40) { u.setSize({ width: w, height: h }); chart.cursor(at); } });
    size.observe(host);
    all.add(chart);
    return chart;
  }
  theme();
  window.matchMedia('(prefers-color-scheme: light)').addEventListener('change', theme);
  return { create, nearest };
})();
