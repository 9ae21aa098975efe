// What the robot shall do next: tasks, places and points, each planned and judged before it can start.
const Work = (() => {
  const $ = id => document.getElementById(id);
  const text = (id, value) => { const e = $(id); if (e.textContent !== value) e.textContent = value; };
  const ask = message => mcdpr.request(message);
  let may = false, orders = [], why = '', preview = null, waits = 0, points = [], replace = '';

  // The tool now, mm, in hundredths.
  const here = () => { const p = mcdpr.live && mcdpr.live.pose; return p ? p.tool_m.map(v => Math.round(v * 1e5) / 100) : null; };
  const number = id => { const v = $(id).valueAsNumber, ok = Number.isFinite(v); $(id).classList.toggle('bad', !ok); return ok ? v : null; };

  async function plan(message) {
    const mine = ++waits;
    verdict('planning ...', false, true);
    const answer = await ask({ order: 'plan', ...message });
    if (mine === waits && !answer.ok) verdict(answer.reason, true, true);
    return answer;
  }

  function verdict(words, broken, alone) {
    $('verdict').hidden = false; $('verdict').classList.toggle('broken', broken);
    text('verdict-words', words);
    if (alone) { preview = null; Scene.setNext([]); $('next').hidden = true; $('margins').replaceChildren(); }
    $('all-margins').hidden = !$('margins').children.length;
    buttons();
  }

  // A step of a jog: a small straight way that is planned, judged, and made if it breaks no limit.
  let step = null;
  async function jogStep(by_mm, speed_mm_s) {
    const now = here();
    if (!now) { verdict('the place of the tool is not known', true, true); return; }
    step = 0;
    const answer = await plan({ to_mm: now.map((v, i) => v + by_mm[i]), speed_mm_s });
    // Esc or Space came meanwhile.
    if (step === null) return;
    step = answer.ok ? answer.data.plan : null;
    makeStep();
  }
  function makeStep() {
    if (!step || !preview || preview.id !== step) return;
    step = null;
    if (preview.ok) ask({ order: 'start', plan: preview.id });
  }

  // A plan that the server has made; all pages see it.
  function show(m) {
    if (m.id === null) { preview = null; Scene.setNext([]); $('next').hidden = true; $('verdict').hidden = true; buttons(); return; }
    preview = m;
    Scene.setNext(m.tool_m); $('next').hidden = !m.tool_m.length;
    $('margins').replaceChildren(...m.margins.map(x => {
      const row = document.createElement('tr');
      const cell = value => { const c = document.createElement('td'); c.textContent = value; row.append(c); };
      cell(x.what); cell(`${x.value.toFixed(1)} of ${x.limit.toFixed(1)} ${x.unit}`); cell(`${x.left_percent.toFixed(0)} %`); cell(x.time_s.toFixed(1));
      return row;
    }));
    verdict(m.ok ? `${m.name}: ${m.duration_s.toFixed(1)} s. Tightest limit: ${m.tightest}.${m.tube ? ` The tool stays within ${(m.tube.widest_m * 1e3).toFixed(2)} mm of the path (95 %).` : ''}` : `${m.name} cannot be run: ${m.reason}`, !m.ok, false);
    makeStep();
  }

  async function list() {
    const answer = await ask({ order: 'tasks' });
    if (answer.ok) fill(answer.data);
  }

  function fill(data) {
    const old = $('task-list').value;
    $('task-list').replaceChildren(...data.tasks.map(t => Object.assign(document.createElement('option'), { value: t.name, textContent: t.built_in ? `${t.name}: ${t.about}` : t.name })));
    if (data.tasks.some(t => t.name === old)) $('task-list').value = old;
    $('task-list').dataset.files = JSON.stringify(data.tasks.filter(t => !t.built_in).map(t => t.name));
    buttons();
  }
  const isFile = () => JSON.parse($('task-list').dataset.files || '[]').includes($('task-list').value);

  function edit(name, body) {
    $('editor').hidden = false; $('task-name').value = name; $('task-text').value = body; replace = '';
  }

  // The points as a task file, which the editor can change and save.
  function asTask() {
    const list = p => `[${p.map(v => v.toFixed(2)).join(', ')}]`, speed = number('points-speed');
    return [`name = "taught points"`, ...(speed ? [`speed_mm_s = ${speed}`] : []), `start_mm = ${list(points[0])}`, '',
      ...points.slice(1).flatMap(p => ['[[leg]]', `to_mm = ${list(p)}`, ''])].join('\n');
  }

  function taught() {
    $('taught').replaceChildren(...points.map(p => Object.assign(document.createElement('li'), { textContent: p.map(v => v.toFixed(1)).join(', ') + ' mm' })));
    buttons();
  }

  // Every button that cannot act says why.
  function set(id, reason) { const b = $(id); b.disabled = !!reason; if (!b.dataset.title) b.dataset.title = b.title || ' '; b.title = reason || b.dataset.title.trim(); }
  function buttons() {
    const no = may ? Steps.busy : why;
    for (const id of ['task-plan', 'task-open', 'text-plan', 'text-save', 'to-plan', 'to-home', 'to-pick', 'plan-forget', 'grip-open', 'grip-close']) set(id, no);
    set('task-edit', no || (isFile() ? '' : 'a built-in task has no text'));
    set('teach', no || (here() ? '' : 'the place of the tool is not known'));
    set('unteach', points.length ? '' : 'there are no points'); set('unteach-all', points.length ? '' : 'there are no points');
    set('points-plan', no || (points.length > 1 ? '' : 'a path needs two points')); set('points-edit', points.length > 1 ? '' : 'a path needs two points');
    set('plan-start', no || (preview && preview.ok ? '' : 'there is no plan within every limit'));
  }

  function allow(now, known, reason) {
    const fresh = now && !may;
    may = now; orders = known; why = reason;
    const works = known.includes('plan');
    $('tabs').hidden = !works; $('jog').hidden = !known.includes('jog') || $('tab-jog').getAttribute('aria-selected') !== 'true';
    $('grip').hidden = !(mcdpr.robot && mcdpr.robot.gripper && known.includes('gripper'));
    if (fresh && works) list();
    if (!now) pick(false);
    buttons();
  }

  // Speeds that the robot can do, until somebody types others.
  let typed = false;
  function speeds(most_mps) {
    if (typed) return;
    for (const id of ['to-speed', 'points-speed']) $(id).value = Math.min(50, Math.floor(most_mps * 900));
  }
  for (const id of ['to-speed', 'points-speed']) $(id).addEventListener('input', () => { typed = true; });

  let picking = false;
  function pick(on) {
    picking = on; $('to-pick').setAttribute('aria-pressed', on); document.body.classList.toggle('picking', on);
  }

  const on = (id, act) => $(id).addEventListener('click', act);
  on('task-plan', () => plan({ task: $('task-list').value }));
  on('task-edit', async () => {
    const name = $('task-list').value, answer = await ask({ order: 'task_read', task: name });
    if (answer.ok) edit(name, answer.data.text);
  });
  on('task-open', () => $('task-file').click());
  $('task-file').addEventListener('change', async () => {
    const file = $('task-file').files[0];
    if (!file) return;
    if (file.size > 48 * 1024) { verdict(`${file.name} is larger than 48 kB: copy it into the folder of tasks`, true, true); return; }
    edit(file.name, await file.text()); $('task-file').value = '';
  });
  $('task-list').addEventListener('change', buttons);
  on('text-plan', () => plan({ task: $('task-name').value, text: $('task-text').value }));
  on('text-save', async () => {
    const name = $('task-name').value;
    const answer = await ask({ order: 'task_save', task: name, text: $('task-text').value, replace: replace === name });
    if (answer.ok) { fill(answer.data); $('task-list').value = name; buttons(); verdict(`${name} is saved.`, false, true); }
    else { replace = answer.reason.includes('exists already') ? name : ''; verdict(answer.reason, true, true); }
  });
  on('text-close', () => { $('editor').hidden = true; });
  for (const closed of [false, true]) on(closed ? 'grip-close' : 'grip-open', () => ask({ order: 'gripper', closed }));

  on('to-plan', () => {
    const to = ['to-x', 'to-y', 'to-z'].map(number), speed = number('to-speed');
    if (to.includes(null) || speed === null) { verdict('A place is three numbers in mm, a speed a number over 0 in mm/s.', true, true); return; }
    plan({ to_mm: to, speed_mm_s: speed });
  });
  on('to-home', () => plan({ home: true }));
  on('to-pick', () => pick(!picking));
  Scene.onPick(at => {
    if (!picking) return;
    const now = here(), z = Number.isFinite($('to-z').valueAsNumber) ? $('to-z').valueAsNumber : now ? now[2] : null;
    const found = z === null ? null : at(z * 1e-3);
    if (!found) return;
    ['to-x', 'to-y', 'to-z'].forEach((id, i) => { $(id).value = (found[i] * 1e3).toFixed(1); });
    pick(false); $('to-plan').click();
  });

  on('teach', () => { const p = here(); if (p) { points.push(p); taught(); } });
  on('unteach', () => { points.pop(); taught(); });
  on('unteach-all', () => { points = []; taught(); });
  on('points-plan', () => {
    const speed = number('points-speed');
    if (speed === null) { verdict('A speed is a number over 0, in mm/s.', true, true); return; }
    plan({ points_mm: points, speed_mm_s: speed });
  });
  on('points-edit', () => { edit('points.toml', asTask()); $('tab-tasks').click(); });

  on('plan-start', () => { if (preview && preview.ok) ask({ order: 'start', plan: preview.id }); });
  on('plan-forget', () => { waits++; ask({ order: 'forget' }); });
  // The place of the tool comes and goes.
  setInterval(buttons, 500);
  taught();
  return { show, allow, speeds, step: jogStep, noStep() { step = null; }, get preview() { return preview; }, get points() { return points; } };
})();
window.mcdpr.work = Work;
