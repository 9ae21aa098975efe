// What only a simulated robot can do: faults, a hand on the platform, another robot, a link to its state.
const Sim = (() => {
  const $ = id => document.getElementById(id);
  const text = (id, value) => { const e = $(id); if (e.textContent !== value) e.textContent = value; };
  const ask = message => mcdpr.request(message);
  const say = (words, bad) => { text('sim-words', words); $('sim-words').classList.toggle('bad', !!bad); };
  let known = [], faults = [];

  async function allow(now, orders, hello) {
    known = orders;
    const works = orders.includes('sim_inject');
    $('tab-sim').hidden = !works;
    if (!works) return;
    $('sim-robots').replaceChildren(...(hello.robots || []).map(name => Object.assign(document.createElement('option'), { value: name, textContent: name })));
    $('sim-own').hidden = !orders.includes('sim_restart');
    const set = hello.playground;
    if (set) {
      if (set.robot) $('sim-robots').value = set.robot;
      $('sim-seed').value = set.seed; $('sim-exact').checked = set.exact;
    }
    const cables = mcdpr.robot.cables.length;
    $('sim-cable').replaceChildren(...Array.from({ length: cables }, (_, i) => Object.assign(document.createElement('option'), { value: i + 1, textContent: `cable ${i + 1}` })));
    const answer = await ask({ order: 'sim_faults' });
    if (!answer.ok) return;
    faults = answer.data;
    $('sim-fault').replaceChildren(...faults.map(f => Object.assign(document.createElement('option'), { value: f.fault, textContent: `${f.fault}: ${f.words}` })));
  }

  const on = (id, act) => $(id).addEventListener('click', act);
  on('sim-inject', async () => {
    const answer = await ask({ order: 'sim_inject', fault: `${$('sim-fault').value}:${$('sim-cable').value}@0s` });
    say(answer.ok ? 'The fault is there until the robot begins anew.' : answer.reason, !answer.ok);
  });
  on('sim-restart', async () => {
    const seed = Number($('sim-seed').value);
    const answer = await ask({ order: 'sim_restart', robot: $('sim-robots').value, seed, exact: $('sim-exact').checked });
    say(answer.ok ? '' : answer.reason, !answer.ok);
  });
  on('sim-check', async () => {
    say('running ...');
    // The page is drawn before it is busy for a while.
    await new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
    const answer = await ask({ order: 'sim_fingerprint', task: null });
    const d = answer.data;
    say(answer.ok ? `${d.sha256} (${d.simulated_s.toFixed(1)} s simulated in ${d.took_s.toFixed(2)} s)` : answer.reason, !answer.ok);
  });
  on('sim-link', async () => {
    const answer = await ask({ order: 'sim_state' });
    if (!answer.ok) { say(answer.reason, true); return; }
    const link = await Playground.link(answer.data);
    $('sim-url').hidden = false; $('sim-url').value = link; $('sim-url').select();
    let copied = false;
    try { await navigator.clipboard.writeText(link); copied = true; } catch { /* the text is selected */ }
    say(copied ? 'The link is copied.' : 'Copy this link.');
  });

  // A hand on the platform: drag it while the switch is on. The force grows with the distance.
  const NEWTONS_PER_M = 100, MOST_N = 20;
  let hand = false, from = null;
  function setHand(now) {
    hand = now; $('sim-hand').setAttribute('aria-pressed', now); document.body.classList.toggle('hand', now);
    text('sim-hand', now ? 'Push the platform: on' : 'Push the platform: off');
    if (!now) letGo();
  }
  function letGo() { if (from) { from = null; ask({ order: 'sim_push', force_n: [0, 0, 0] }); } }
  on('sim-hand', () => setHand(!hand));
  let sent = 0;
  Scene.onDrag({
    begin: at => { if (!hand || !mcdpr.live || !mcdpr.live.pose) return false; from = at(mcdpr.live.pose.tool_m[2]); return !!from; },
    move: at => {
      const to = from && at(mcdpr.live.pose.tool_m[2]), now = performance.now();
      if (!to || now - sent < 30) return;
      sent = now;
      let force = to.map((v, i) => i < 2 ? (v - from[i]) * NEWTONS_PER_M : 0);
      const size = Math.hypot(...force);
      if (size > MOST_N) force = force.map(v => v * MOST_N / size);
      ask({ order: 'sim_push', force_n: force });
      say(`pushed with ${Math.min(size, MOST_N).toFixed(0)} N`);
    },
    end: () => { letGo(); say(''); },
  });
  return { allow };
})();
