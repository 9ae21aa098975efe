// Takes the place of the server: the robot runs in WebAssembly in this page.
const Playground = (() => {
  'use strict';
  let wasm = null, socket = null;
  const text = new TextDecoder(), bytes = new TextEncoder();
  const read = (at, length) => text.decode(new Uint8Array(wasm.memory.buffer, at, length));

  // Waits that are not stretched to 4 ms, as those of setTimeout are.
  const channel = new MessageChannel(), soon = [];
  channel.port1.onmessage = () => { const go = soon.shift(); if (go) go(); };
  const wait = ms => new Promise(done => {
    if (ms > 4) setTimeout(done, ms - 1);
    else { soon.push(done); channel.port2.postMessage(0); }
  });

  const stopped = reason => {
    const alarm = document.getElementById('alarm');
    alarm.hidden = false; alarm.textContent = reason;
    if (socket) socket.close();
  };

  async function unpacked(base64) {
    const raw = Uint8Array.from(atob(base64), c => c.charCodeAt(0));
    const stream = new Blob([raw]).stream().pipeThrough(new DecompressionStream('gzip'));
    return new Response(stream).arrayBuffer();
  }

  function send(message) {
    for (const byte of bytes.encode(message)) wasm.put(byte);
    wasm.sent();
  }

  // A file goes before the order that names it.
  function file(raw) {
    for (const byte of raw) wasm.put(byte);
    wasm.sent_file();
  }

  // What a link to this page says: which robot, which seed, where its tool hangs.
  async function fromLink() {
    const packed = new URLSearchParams(location.hash.slice(1)).get('state');
    if (!packed) return {};
    const raw = Uint8Array.from(atob(packed.replace(/-/g, '+').replace(/_/g, '/')), c => c.charCodeAt(0));
    const stream = new Blob([raw]).stream().pipeThrough(new DecompressionStream('deflate-raw'));
    return JSON.parse(await new Response(stream).text());
  }

  async function link(state) {
    const stream = new Blob([JSON.stringify(state)]).stream().pipeThrough(new CompressionStream('deflate-raw'));
    const raw = new Uint8Array(await new Response(stream).arrayBuffer());
    const packed = btoa(Array.from(raw, b => String.fromCharCode(b)).join(''));
    const url = new URL(location.href);
    url.hash = 'state=' + packed.replace(/\+/g, '-').replace(/\//g, '_').replace(/=+$/, '');
    return url.href;
  }

  async function start() {
    if (!WebAssembly.Suspending || !WebAssembly.promising) {
      stopped('This browser cannot suspend WebAssembly (JSPI). Chrome, Edge and Chromium can from version 137 on.');
      return;
    }
    const page = {
      pause: new WebAssembly.Suspending(wait),
      now_ms: () => performance.now(),
      deliver: (at, length) => { if (socket && socket.onmessage) socket.onmessage({ data: read(at, length) }); },
      failed: (at, length) => stopped('The simulation has stopped: ' + read(at, length) + '. Load the page again.'),
    };
    const module = await unpacked(PLAYGROUND_WASM);
    const { instance } = await WebAssembly.instantiate(module, { page });
    wasm = instance.exports;
    let state = { damaged: true };
    try { state = await fromLink(); } catch { /* said by the robot */ }
    // The first message says which robot it is.
    send(JSON.stringify(state));
    socket.readyState = 1; socket.onopen();
    WebAssembly.promising(wasm.run)().catch(error => stopped('The simulation has stopped: ' + error.message + '. Load the page again.'));
  }

  // As much of a WebSocket as the page uses.
  class Line {
    constructor() { this.readyState = 0; socket = this; start().catch(error => stopped('The playground cannot start: ' + error.message)); }
    send(message) { send(message); }
    close() { this.readyState = 3; }
  }
  return { Line, link, file };
})();
