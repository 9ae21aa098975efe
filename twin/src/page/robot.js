// The robot file: its values, and a changed text with what differs, before it is saved.
const RobotFile = (() => {
  const $ = id => document.getElementById(id);
  const ask = message => mcdpr.request(message);
  let file = null, checked = null, may = false, why = '';

  function words(text, bad) { $('robot-words').textContent = text; $('robot-words').classList.toggle('bad', !!bad); }

  const cells = (...parts) => {
    const row = document.createElement('tr');
    row.append(...parts.map(part => { const c = document.createElement('td'); c.append(...[part].flat()); return c; }));
    return row;
  };
  const mark = (tag, text) => Object.assign(document.createElement(tag), { textContent: text });

  async function open(again) {
    if (!may || (file && !again)) { buttons(); return; }
    const answer = await ask({ order: 'robot_read' });
    if (!answer.ok) { words(answer.reason, true); return; }
    file = answer.data; checked = null;
    $('robot-text').value = file.text;
    $('robot-name').textContent = file.file || `${file.name}, built into the program`;
    $('robot-settings').replaceChildren(...file.settings.map(s => {
      const row = cells(s.key, s.value);
      row.title = [s.meaning, s.allowed].filter(Boolean).join('; ');
      return row;
    }));
    $('robot-changes').tBodies[0].replaceChildren();
    words('', false); buttons();
  }

  async function check() {
    const text = $('robot-text').value, answer = await ask({ order: 'robot_check', text });
    const rows = answer.ok ? answer.data.changes : [];
    $('robot-changes').tBodies[0].replaceChildren(...rows.map(c => {
      const row = cells(c.key, [mark('del', c.before === null ? 'default' : c.before), ' \u2192 ', mark('ins', c.after === null ? 'default' : c.after)]);
      row.title = [c.meaning, c.allowed].filter(Boolean).join('; ');
      return row;
    }));
    checked = answer.ok ? text : null;
    words(answer.ok ? (rows.length ? `${rows.length} ${rows.length === 1 ? 'value differs' : 'values differ'} from the file` : 'no value differs from the file') : answer.reason, !answer.ok);
    buttons();
  }

  async function save() {
    const answer = await ask({ order: 'robot_save', text: checked, before: file.mark });
    if (!answer.ok) { words(answer.reason, true); return; }
    const { kept, words: said } = answer.data;
    await open(true);
    words(said || `Saved; the old text is in ${kept}. Use it now, or from the next start of mcdpr serve on.`, false);
  }

  // The server reads robot file and calibration again; the page connects to it anew.
  async function use() {
    const answer = await ask({ order: 'reload' });
    words(answer.ok ? 'Robot file and calibration are in use.' : answer.reason, !answer.ok);
  }

  const set = (id, reason) => { $(id).disabled = !!reason; $(id).title = reason; };
  function buttons() {
    const no = may ? file ? '' : 'the file was not read yet' : why, text = $('robot-text').value;
    // Messages have a greatest size.
    set('robot-check', no || (new Blob([text]).size > 48 * 1024 ? 'larger than 48 kB: change it in an editor' : '')); set('robot-again', may ? '' : why);
    const live = mcdpr.live, moving = live && live.task ? `${live.task} is under way: stop it first` : '';
    set('robot-use', may ? moving : why);
    set('robot-save', no || (!file.file ? 'a built-in robot has no file: mcdpr config init FILE --copy makes one'
      : checked === null || checked !== text ? 'check it first' : text === file.text ? 'nothing was changed' : ''));
  }

  const on = (id, act) => $(id).addEventListener('click', act);
  on('robot-check', check); on('robot-save', save); on('robot-again', () => open(true)); on('robot-use', use);
  $('robot-text').addEventListener('input', buttons);
  // Another robot: its file is read when it is looked at.
  function forget() { file = checked = null; if (!$('robot').hidden) open(true); }

  setInterval(() => { if (!$('robot').hidden) buttons(); }, 500);
  return { forget,
    open, use,
    allow(now, reason) {
      const fresh = now && !may;
      may = now; why = reason;
      // Forgotten while the page could not ask.
      if (fresh && !file && !$('robot').hidden) open(true).then(() => words('The server uses this file.', false));
      buttons();
    },
    get file() { return file; },
  };
})();
window.mcdpr.robotFile = RobotFile;
