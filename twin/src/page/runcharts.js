// Charts of a recorded run: all show the same times and the same cursor, and the server sends finer data for a part.
const RunCharts = (() => {
  const $ = id => document.getElementById(id);
  const box = $('run-charts');
  let name = null, whole = [0, 1], range = [0, 1], data = null, plots = [], busy = false, asked = '', follow = null, cursor = null, requests = 0;

  async function fetchPart() {
    const columns = Math.round(Math.max(200, Math.min(1500, (box.clientWidth || 600) * (devicePixelRatio || 1))));
    const key = () => `/runs/${encodeURIComponent(name)}/traces/${range[0].toFixed(4)}/${range[1].toFixed(4)}/${columns}`;
    // One request at a time; the last wish is fetched when the one before has come.
    if (busy || !name) return;
    busy = true;
    try {
      while (name && key() !== asked) {
        const path = asked = key(), mine = name;
        const part = await mcdpr.document(path);
        requests++;
        if (mine === name) take(part);
      }
    } catch (error) { asked = ''; $('run-trouble').textContent = `no charts: ${error.message}`; }
    busy = false;
  }

  function take(found) {
    const first = !data;
    data = found;
    if (first) {
      whole = [0, Math.max(0.01, data.duration_s || 0)]; range = whole; build();
    }
    fill();
  }

  // What is drawn of the groups of the data: [group, factor, names, dashed].
  function build() {
    plots.forEach(p => p.chart.remove());
    const t = data.traces, cables = t.tensions_n.map((_, i) => String(i + 1));
    const limits = [data.tension_min_n, data.tension_max_n];
    const charts = [
      ['Tool position', 'mm', 2, [['tool_m', 1e3, ['x', 'y', 'z']], ['planned_tool_m', 1e3, ['x planned', 'y planned', 'z planned'], true]]],
      ['Path error', 'mm', 3, [['path_error_m', 1e3, ['error']]]],
      ['Tensions', 'N', 3, [['tensions_n', 1, cables], ['expected_n', 1, cables.map(c => c + ' planned'), true]], () => limits],
      ['Length errors', 'mm', 3, [['length_errors_m', 1e3, cables]]],
      ['Lengths', 'mm', 2, [['lengths_m', 1e3, cables]]],
      ['Motor currents', 'A', 3, [['currents_a', 1, cables]]],
      ['Path time', 's', 3, [['path_s', 1, ['path']]]],
    ];
    plots = charts.filter(([, , , [[group]]]) => t[group].length || group === 'tool_m' && t.planned_tool_m.length).map(([title, unit, digits, groups, ends]) => {
      const lines = groups.flatMap(([group, factor, names, dashed]) => t[group].map((_, i) => ({ name: names[i], color: i, dashed, group, i, factor })));
      const chart = Charts.create({ title, unit, digits, lines, limits: ends, onView: view, onCursor: at => { move(at); if (at !== null && follow) follow(toSlider(at)); }, reset });
      box.append(chart.figure);
      return { chart, lines, title };
    });
  }

  function fill() {
    for (const { chart, lines } of plots) {
      const scaled = (list, factor) => list && (factor === 1 ? list : list.map(v => v === null ? null : v * factor));
      chart.set(data.time_s, lines.map(l => { const [low, high] = data.traces[l.group][l.i] || [[]]; return [scaled(low, l.factor), scaled(high, l.factor)]; }));
      chart.view(...range);
    }
    move(cursor);
  }

  function view(from, to) {
    const least = 0.005, width = Math.max(least, Math.min(to - from, whole[1] - whole[0]));
    const begin = Math.max(whole[0], Math.min(from, whole[1] - width));
    range = [begin, begin + width];
    plots.forEach(p => p.chart.view(...range));
    fetchPart();
  }
  const reset = () => view(...whole);

  function move(at) { cursor = at; plots.forEach(p => p.chart.cursor(at)); }

  // The slider of a board's run has the plan's time.
  function toSlider(at) {
    if (data.clock !== 'path') return at;
    const path = data.traces.path_s[0];
    return path ? path[0][Charts.nearest(data.time_s, at)] || 0 : 0;
  }
  function fromSlider(at) {
    if (data.clock !== 'path') return at;
    const path = data.traces.path_s[0], i = path ? path[0].findIndex(v => v !== null && v >= at) : -1;
    return i < 0 ? null : data.time_s[i];
  }

  for (const [id, act] of [['run-closer', () => view(...about(0.5))], ['run-wider', () => view(...about(2))], ['run-whole', reset]]) $(id).addEventListener('click', act);
  const about = by => { const m = cursor !== null && cursor > range[0] && cursor < range[1] ? cursor : 0.5 * (range[0] + range[1]); return [m - (m - range[0]) * by, m + (range[1] - m) * by]; };

  return {
    // Shows a run; `then` gets the time of the cursor as the slider counts it.
    open(run, then) {
      name = run; follow = then; data = null; asked = ''; cursor = null; range = [0, 1e6];
      document.body.classList.add('past'); $('run-view').hidden = false;
      fetchPart();
    },
    close() { name = data = null; asked = ''; plots.forEach(p => p.chart.remove()); plots = []; $('run-view').hidden = true; document.body.classList.remove('past'); },
    cursor(at) { if (data) move(fromSlider(at)); },
    get range() { return range; }, get data() { return data; }, get requests() { return requests; }, get busy() { return busy; },
    chart: title => (plots.find(p => p.title === title) || {}).chart, get titles() { return plots.map(p => p.title); },
  };
})();
window.mcdpr.runCharts = RunCharts;
