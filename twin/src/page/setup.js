// Set-up in steps: each is a command of the program. Its line is shown, what moves is confirmed, its output is read.
const Steps = (() => {
  const $ = id => document.getElementById(id);
  const ask = message => mcdpr.request(message);
  const make = (tag, props, ...children) => { const e = Object.assign(document.createElement(tag), props); e.append(...children); return e; };
  const text = (e, value) => { if (e.textContent !== value) e.textContent = value; };
  const WORDS = { running: 'running', done: 'done', failed: 'failed' };
  const cards = new Map(), LINES = 300, SHOWN = 5;
  let known = null, may = false, why = '';

  // A button that cannot act says why.
  const set = (b, reason, title) => { b.disabled = !!reason; b.title = reason || title || ''; };

  function field(step, option, changed) {
    const id = `step-${step.id}-${option.name}`;
    let input;
    if (option.kind === 'flag') input = make('input', { type: 'checkbox', id });
    else if (option.kind === 'choice') {
      input = make('select', { id }, ...option.choices.map(c => make('option', { value: c, textContent: c || 'none' })));
      input.value = option.default;
    } else {
      input = make('input', { id, autocomplete: 'off', spellcheck: false, value: option.default });
      if (option.kind === 'number') Object.assign(input, { type: 'number', min: option.least, max: option.most, step: option.whole ? 1 : 'any' });
    }
    input.addEventListener('input', changed); input.addEventListener('change', changed);
    return { option, input, row: make('label', { htmlFor: id, className: option.kind }, option.label + ' ', input) };
  }

  function card(step) {
    const c = { step, fields: [], run: 0, judged: null, asked: 0 };
    const changed = () => { c.confirm.hidden = true; judge(c); };
    c.state = make('span', { className: 'pill quiet', id: `step-${step.id}-state`, textContent: 'not done' });
    c.line = make('code', { id: `step-${step.id}-line`, className: 'line-of' });
    c.fields = step.options.map(o => field(step, o, changed));
    c.start = make('button', { id: `step-${step.id}-run`, textContent: 'Run' });
    c.stop = make('button', { id: `step-${step.id}-stop`, textContent: 'Stop this step' });
    c.wrong = make('p', { className: 'bad', id: `step-${step.id}-wrong` }); c.wrong.setAttribute('role', 'alert');
    c.yes = make('button', { id: `step-${step.id}-yes`, className: 'go', textContent: 'Yes, do it' });
    c.no = make('button', { id: `step-${step.id}-no`, textContent: 'No' });
    c.moves = make('p', { className: 'strong' });
    c.confirm = make('div', { className: 'confirm', hidden: true }, c.moves, make('div', { className: 'two' }, c.yes, c.no));
    c.confirm.setAttribute('role', 'alertdialog'); c.confirm.setAttribute('aria-label', `Confirm: ${step.title}`);
    c.question = make('p', { className: 'strong', id: `step-${step.id}-asks` }); c.question.setAttribute('role', 'alert');
    c.answer = make('input', { id: `step-${step.id}-answer`, autocomplete: 'off', spellcheck: false, maxLength: 100 });
    c.answer.setAttribute('aria-label', 'Answer');
    c.say = make('button', { id: `step-${step.id}-say`, textContent: 'Answer' });
    c.sayYes = make('button', { id: `step-${step.id}-say-yes`, className: 'go', textContent: 'Yes' });
    c.sayNo = make('button', { id: `step-${step.id}-say-no`, textContent: 'No' });
    c.asks = make('div', { className: 'confirm', hidden: true }, c.question, make('div', { className: 'two' }, c.sayYes, c.sayNo), make('div', { className: 'two' }, c.answer, c.say));
    c.reason = make('p', { className: 'bad', id: `step-${step.id}-reason` }); c.reason.setAttribute('role', 'alert');
    c.next = make('p', { id: `step-${step.id}-next` });
    c.progress = make('progress', { max: 1, value: 0, hidden: true }); c.progress.setAttribute('aria-label', `Progress: ${step.title}`);
    c.result = make('ul', { className: 'result', id: `step-${step.id}-result` });
    c.output = make('ol', { className: 'output', id: `step-${step.id}-output`, tabIndex: 0 }); c.output.setAttribute('aria-label', `Output of ${step.title}`);
    c.outputs = make('details', {}, make('summary', { textContent: 'Output' }), c.output);
    c.more = make('div', { id: `step-${step.id}-more` });
    // The first options are those that matter most.
    const rows = c.fields.map(f => f.row), options = make('div', { className: 'options' }, ...rows.slice(0, SHOWN));
    if (rows.length > SHOWN) options.append(make('details', {}, make('summary', { textContent: 'More options' }), ...rows.slice(SHOWN)));
    c.body = make('div', {}, make('p', { textContent: step.purpose }), options, make('p', {}, c.line), c.wrong,
      make('div', { className: 'two' }, c.start, c.stop), c.confirm, c.asks, c.progress, c.reason, c.next, c.result, c.more, c.outputs);
    const title = make('span', { textContent: step.title });
    c.all = step.tab === 'pick' ? make('div', {}, make('div', { className: 'row' }, title, c.state), c.body)
      : make('details', { className: 'step', id: `step-${step.id}` }, make('summary', {}, title, c.state), c.body);
    c.start.addEventListener('click', () => press(c));
    c.yes.addEventListener('click', () => { const line = c.judged && c.judged.line; c.confirm.hidden = true; begin(c, line); });
    c.no.addEventListener('click', () => { c.confirm.hidden = true; });
    c.stop.addEventListener('click', () => mcdpr.send({ order: 'stop' }));
    const say = words => ask({ order: 'step_answer', text: words }).then(a => { if (a.ok) c.answer.value = ''; text(c.wrong, a.ok ? '' : a.reason); });
    c.say.addEventListener('click', () => say(c.answer.value));
    c.answer.addEventListener('keydown', e => { if (e.key === 'Enter') say(c.answer.value); });
    c.sayYes.addEventListener('click', () => say('y')); c.sayNo.addEventListener('click', () => say('n'));
    if (step.tab !== 'pick') c.all.addEventListener('toggle', () => { if (c.all.open) judge(c); });
    return c;
  }

  const values = c => Object.fromEntries(c.fields.filter(f => !f.row.hidden).map(f => [f.option.name, f.option.kind === 'flag' ? f.input.checked : f.input.value]));

  // The line that these options make, or what is wrong with them.
  async function judge(c) {
    if (!may) return;
    const mine = ++c.asked, answer = await ask({ order: 'step_line', step: c.step.id, options: values(c) });
    if (mine !== c.asked) return;
    c.judged = answer.ok ? answer.data : null;
    text(c.line, answer.ok ? answer.data.line : ''); text(c.wrong, answer.ok ? '' : answer.reason);
    buttons();
  }

  async function press(c) {
    await judge(c);
    if (!c.judged) return;
    if (!c.judged.moves) { begin(c, null); return; }
    text(c.moves, `${c.judged.moves} Is the robot free to move?`);
    c.confirm.hidden = false; c.yes.focus();
  }

  async function begin(c, confirmed) {
    const answer = await ask({ order: 'step_run', step: c.step.id, options: values(c), confirmed });
    text(c.wrong, answer.ok ? '' : answer.reason);
    if (answer.ok) c.outputs.open = true;
  }

  // All pages with or without the token see the same.
  function take(m) {
    if (!cards.size) {
      for (const step of m.steps) {
        const c = card(step); cards.set(step.id, c);
        $(step.tab === 'pick' ? 'pick-step' : 'steps').append(c.all);
      }
      extras();
    }
    known = m;
    for (const c of cards.values()) {
      const s = m.states[c.step.id], state = s ? s.state : '', waits = m.waits && m.running === c.step.id;
      text(c.state, waits ? 'waits for the robot' : WORDS[state] || 'not done');
      c.state.className = 'pill ' + ({ running: 'move', done: 'good', failed: 'bad' }[state] || 'quiet');
      text(c.reason, s && s.reason ? `Failed: ${s.reason}` : ''); text(c.next, s && s.next ? `Next: ${s.next}` : '');
      if (c.run !== (s ? s.run : 0)) { c.run = s ? s.run : 0; c.output.replaceChildren(); c.progress.hidden = true; c.progress.value = 0; }
      // Who only looks sees the line of the last run.
      if (!may && s) text(c.line, s.line);
      const result = s && s.result || [];
      c.result.replaceChildren(...result.map(line => make('li', { textContent: line })));
      const asks = m.running === c.step.id && m.asks;
      c.asks.hidden = !asks; text(c.question, asks ? asks.replace(/\s*\[y\/n\]$/i, '') : '');
      if (asks && c.all.tagName === 'DETAILS') c.all.open = true;
      if (state !== 'running') c.progress.hidden = true;
    }
    calibration(m.calibration); buttons();
  }

  function output(lines) {
    for (const line of lines) {
      const c = [...cards.values()].find(k => k.run === line.run);
      if (!c) continue;
      const under = c.output.scrollTop + c.output.clientHeight > c.output.scrollHeight - 30;
      c.output.append(make('li', { className: line.kind, textContent: line.text }));
      while (c.output.children.length > LINES) c.output.firstChild.remove();
      if (under) c.output.scrollTop = c.output.scrollHeight;
      const count = /^pose (\d+) of (\d+):/.exec(line.text) || /^place (\d+)/.exec(line.text);
      if (count && known.states[c.step.id].state === 'running') {
        c.progress.hidden = false; c.progress.max = Number(count[2] || c.fields.find(f => f.option.name === 'places').input.value); c.progress.value = Number(count[1]);
      }
    }
  }

  // The result of a calibration is used once it is accepted.
  let files = null;
  const kept = {};
  function extras() {
    const c = cards.get('calibrate');
    kept.words = make('p', { id: 'kept-words' }); kept.words.setAttribute('role', 'status');
    for (const [name, words, order] of [['accept', 'Accept', 'calibration_accept'], ['discard', 'Discard', 'calibration_discard'], ['back', 'Go back', 'calibration_back']]) {
      kept[name] = make('button', { id: `kept-${name}`, textContent: words });
      kept[name].addEventListener('click', async () => {
        const answer = await ask({ order });
        const failed = answer.ok && answer.data && answer.data.history_failed;
        text(c.wrong, answer.ok ? failed ? `It is in use, but not in its history: ${failed}` : '' : answer.reason);
      });
    }
    kept.use = make('button', { id: 'kept-use', textContent: 'Use it now' });
    kept.use.addEventListener('click', async () => {
      const answer = await ask({ order: 'reload' });
      text(c.wrong, answer.ok ? '' : answer.reason);
    });
    c.more.append(kept.words, make('div', { className: 'three' }, kept.accept, kept.discard, kept.back), kept.use);
  }
  function calibration(f) {
    files = f;
    const words = [f.used ? f.applied ? `In use: ${f.used}${f.made ? `, made ${f.made}` : ''}. Steps apply it from their next start on, this server once you press Use it now.` : `${f.used} is not applied: this server was started with --calibration none.` : 'No calibration is in use.'];
    if (f.proposal) words.push(`${f.proposal} is new and not in use yet: accept it, or discard it.`);
    if (f.before) words.push(`Before it: ${f.before}; mcdpr calibrate history lists all and goes back to any.`);
    text(kept.words, words.join(' '));
  }

  function buttons() {
    if (!known) return;
    const moving = mcdpr.live && !known.running && mcdpr.live.task && ['Arming', 'Moving', 'Pausing', 'Holding'].includes(mcdpr.live.state);
    const busy = known.running ? `${known.running} is under way: stop it first` : moving ? `${mcdpr.live.task} is under way: stop it first` : '';
    for (const c of cards.values()) {
      set(c.start, !may ? why : busy || (c.wrong.textContent && !c.judged ? c.wrong.textContent : ''), c.step.purpose);
      set(c.yes, !may ? why : busy); set(c.no, '');
      set(c.stop, !may ? why : known.running === c.step.id ? '' : 'this step does not run', 'Esc');
      for (const b of [c.say, c.sayYes, c.sayNo]) set(b, !may ? why : known.asks ? '' : 'nothing is asked');
      c.answer.disabled = !may;
    }
    const no = !may ? why : busy;
    set(kept.accept, no || (!files.proposal ? 'there is no new calibration: run this step' : files.applied ? '' : 'this server was started with --calibration none'), 'Use it from now on; the one before is kept');
    set(kept.discard, no || (files.proposal ? '' : 'there is no new calibration: run this step'), 'Do not use it; it stays as a file');
    set(kept.use, no, 'This server reads robot file and calibration again and uses them');
    set(kept.back, no || (files.before ? '' : 'there is no calibration before this one'), 'Use the calibration before again; the present one is kept');
  }

  function open() { for (const c of cards.values()) if (c.step.tab === 'pick' || c.all.open) judge(c); }

  return {
    take, output, open, make,
    // Opens a step and starts it as its button does. An opened step asks for its line; that must be over first.
    async go(id) { const c = cards.get(id); if (!c) return; c.all.open = true; c.all.scrollIntoView(); await judge(c); if (c.start.disabled) c.start.focus(); else press(c); },
    // What other tabs may not start meanwhile.
    get busy() { return known && known.running ? `${known.running} is under way: stop it first` : ''; },
    allow(now, reason) { const fresh = now && !may; may = now; why = reason; if (fresh) open(); buttons(); },
    buttons,
    get known() { return known; },
  };
})();
window.mcdpr.steps = Steps;
// The robot comes to rest and moves again without a message of its own.
setInterval(Steps.buttons, 500);
