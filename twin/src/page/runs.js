// Runs of before: their figures, and their motion in the drawing. Whatever the robot does is shown first.
const Runs = (() => {
  const $ = id => document.getElementById(id);
  const text = (id, value) => { const e = $(id); if (e.textContent !== value) e.textContent = value; };
  const MOVES = ['Arming', 'Moving', 'Pausing', 'Stopping', 'Fault', 'EStop'];
  let run = null, at = 0, playing = null, busy = false;

  const get = path => mcdpr.document(path);

  async function list() {
    try {
      const { runs, folder } = await get('/runs');
      for (const id of ['run-list', 'run-other']) {
        const old = $(id).value;
        $(id).replaceChildren(...runs.map(name => Object.assign(document.createElement('option'), { value: name, textContent: name })));
        if (runs.includes(old)) $(id).value = old;
      }
      other();
      text('run-trouble', runs.length ? '' : `there are no runs in ${folder}`);
    } catch (error) { text('run-trouble', `the runs cannot be listed: ${error.message}`); }
    buttons();
  }

  // A run is not compared with itself.
  function other() {
    const [one, two] = [$('run-list'), $('run-other')];
    if (one.value !== two.value) return;
    const another = [...two.options].find(o => o.value !== one.value);
    if (another) two.value = another.value;
  }

  async function show() {
    back(); busy = true; buttons(); text('run-trouble', 'reading ...');
    try { shown(await get(`/runs/${encodeURIComponent($('run-list').value)}`)); text('run-trouble', ''); }
    catch (error) { text('run-trouble', error.message); }
    busy = false; buttons();
  }

  function shown(found) {
    run = found;
    RunCharts.open(run.name, time => { if (run && run.drawn) { play(false); to(time, true); } });
    const j = run.judgement, mm = v => (v * 1e3).toFixed(2) + ' mm';
    $('run-shown').hidden = false; $('run-motion').hidden = !run.drawn;
    text('run-words', `${run.task} on ${run.robot}, ${run.duration_s.toFixed(1)} s` + (run.damage ? `; ${run.damage}` : '')
      + (run.drawn ? '' : run.instants.length ? '; another robot: it is not drawn' : '; it has no motion'));
    $('run-robot').hidden = !opens || run.drawn || !run.instants.length;
    const rows = [];
    if (j.path_error_m) rows.push(['path error, mean / max', `${mm(j.path_error_m.mean)} / ${mm(j.path_error_m.max)}`]);
    if (j.cable_length_error_m) rows.push(['length error, mean / max', `${mm(j.cable_length_error_m.mean)} / ${mm(j.cable_length_error_m.max)}`]);
    for (const v of j.verdicts) rows.push([v.what, `${v.pass ? 'pass' : 'FAIL'}: ${v.numbers}`]);
    $('run-figures').replaceChildren(...rows.map(row => {
      const line = document.createElement('tr');
      line.append(...row.map(words => Object.assign(document.createElement('td'), { textContent: words })));
      return line;
    }));
    if (run.drawn) { $('run-time').max = run.instants[run.instants.length - 1].time_s; to(0); }
  }

  // The instant at or before a time of the run.
  function to(time_s, fromCharts) {
    at = Math.max(0, Math.min(time_s, Number($('run-time').max)));
    let low = 0, high = run.instants.length - 1;
    while (low < high) { const middle = (low + high + 1) >> 1; if (run.instants[middle].time_s <= at) low = middle; else high = middle - 1; }
    const i = run.instants[low];
    Scene.setPast({ plan: run.planned_m, trace: run.instants.slice(0, low + 1).map(k => k.tool_m), live: { tensions_n: i.tensions_n }, pose: i });
    $('run-time').value = at;
    if (!fromCharts) RunCharts.cursor(at);
    text('past', `recorded run, ${at.toFixed(1)} of ${Number($('run-time').max).toFixed(1)} s (${run.source})`); $('past').hidden = false;
    buttons();
  }

  function play(on) {
    if (playing) { cancelAnimationFrame(playing.frame); playing = null; }
    if (on && run && run.drawn) {
      if (at >= Number($('run-time').max)) at = 0;
      const from = at, began = performance.now(), mine = playing = {};
      const step = now => {
        if (playing !== mine) return;
        to(from + Math.max(0, now - began) / 1e3);
        if (at >= Number($('run-time').max)) { playing = null; buttons(); } else mine.frame = requestAnimationFrame(step);
      };
      mine.frame = requestAnimationFrame(step);
    }
    buttons();
  }

  function back() { play(false); Scene.setPast(null); RunCharts.close(); $('past').hidden = true; buttons(); }

  const set = (id, reason) => { $(id).disabled = !!reason; $(id).title = reason; };
  function buttons() {
    const none = busy ? 'a run is being read' : $('run-list').options.length ? '' : 'there are no runs';
    for (const id of ['run-show', 'run-report']) set(id, none);
    set('run-compare', none || ($('run-list').options.length > 1 ? $('run-list').value === $('run-other').value ? 'choose two runs' : '' : 'there is only one run'));
    set('run-live', Scene.past || document.body.classList.contains('past') ? '' : 'the robot itself is shown');
    text('run-play', playing ? 'Pause' : 'Play');
  }

  // A playground opens records and has no server that writes reports.
  let opens = false;
  function allow(orders) {
    opens = orders.includes('record_open');
    $('run-open').hidden = !opens;
    for (const id of ['run-report', 'run-again', 'run-with', 'run-compare']) $(id).hidden = opens;
  }
  async function open(file) {
    back(); busy = true; buttons(); text('run-trouble', `reading ${file.name} ...`);
    let trouble = '';
    try {
      Playground.file(new Uint8Array(await file.arrayBuffer()));
      const answer = await mcdpr.request({ order: 'record_open', name: file.name });
      if (!answer.ok) throw new Error(answer.reason);
      await list();
      $('run-list').value = answer.data.name;
    } catch (error) { trouble = error.message; }
    $('run-file').value = ''; busy = false; buttons();
    if (trouble) text('run-trouble', trouble); else await show();
  }
  // The robot of the record takes the stage, and the record is drawn in its frame.
  async function take() {
    const before = mcdpr.robot;
    const answer = await mcdpr.request({ order: 'record_robot', name: run.name });
    if (!answer.ok) { text('run-trouble', answer.reason); return; }
    const look = () => { if (mcdpr.robot !== before) show(); else requestAnimationFrame(look); };
    look();
  }

  const on = (id, act) => $(id).addEventListener('click', act);
  const page = path => window.open(path, '_blank', 'noopener');
  const name = id => encodeURIComponent($(id).value);
  on('run-show', show);
  on('run-robot', take);
  $('run-file').addEventListener('change', () => { if ($('run-file').files[0]) open($('run-file').files[0]); });
  on('run-again', list);
  on('run-report', () => page(`/runs/${name('run-list')}/report`));
  on('run-compare', () => page(`/runs/${name('run-list')}/compare/${name('run-other')}`));
  on('run-play', () => play(!playing));
  on('run-live', back);
  on('run-leave', back);
  $('run-list').addEventListener('change', () => { other(); buttons(); });
  $('run-other').addEventListener('change', buttons);
  $('run-time').addEventListener('input', () => { play(false); to($('run-time').valueAsNumber); });
  buttons();
  return {
    list, allow,
    // A robot that moves is never hidden behind a recorded one.
    live(m) { if ((Scene.past || RunCharts.data) && MOVES.includes(m.state)) back(); },
    get at() { return at; }, get run() { return run; },
  };
})();
window.mcdpr.runs = Runs;
