//! A headless Chromium, driven over its own protocol, and the program that serves the page.
#![allow(dead_code, reason = "each test program uses a part")]

use mcdpr_tests::mcdpr;
use serde_json::{Value, json};
use std::io::{BufRead as _, BufReader};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};
use tungstenite::{Message, WebSocket};

/// `mcdpr serve` in a process of its own.
pub struct Serve {
    child: Child,
    address: String,
    with_token: String,
}

impl Serve {
    pub fn start(arguments: &[&str]) -> Self {
        Self::start_in(Path::new("."), arguments)
    }

    /// As [`Serve::start`], in this folder.
    pub fn start_in(folder: &Path, arguments: &[&str]) -> Self {
        let port: &[&str] = if arguments.contains(&"--port") {
            &[]
        } else {
            &["--port", "0"]
        };
        let mut child = mcdpr()
            .current_dir(folder)
            .args(["serve", "--json", "--token", "letmein"])
            .args(port)
            .args(arguments)
            .stdout(Stdio::piped())
            .stdin(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let stdout = child.stdout.take().unwrap();
        BufReader::new(stdout).read_line(&mut line).unwrap();
        let said: Value = serde_json::from_str(&line).unwrap();
        let text = |key: &str| said[key].as_str().unwrap().to_owned();
        Self {
            address: text("address"),
            with_token: text("address_with_token"),
            child,
        }
    }

    pub fn address(&self) -> String {
        self.address.clone()
    }

    pub fn with_token(&self) -> String {
        self.with_token.clone()
    }

    pub fn port(&self) -> String {
        let rest = self.address.rsplit(':').next().unwrap();
        rest.trim_end_matches('/').to_owned()
    }
}

impl Serve {
    /// Whether the program still runs.
    pub fn runs(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }
}

impl Drop for Serve {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A browser.
pub struct Browser {
    child: Child,
    endpoint: String,
    profile: PathBuf,
}

impl Browser {
    pub fn start() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let name = format!("mcdpr-browser-{}-{number}", std::process::id());
        let profile = std::env::temp_dir().join(name);
        let program = ["chromium", "chromium-browser", "google-chrome"]
            .into_iter()
            .find(|name| Command::new(name).arg("--version").output().is_ok())
            .expect("Chromium is not there: run `cargo xtask test`, which installs it");
        let mut child = Command::new(program)
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--no-first-run",
                "--disable-extensions",
                "--disable-background-timer-throttling",
                "--disable-renderer-backgrounding",
                "--disable-backgrounding-occluded-windows",
                "--remote-debugging-port=0",
                "--window-size=1360,900",
            ])
            .arg(format!("--user-data-dir={}", profile.display()))
            .arg("about:blank")
            .stderr(Stdio::piped())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let endpoint = lines
            .find_map(|line| {
                line.unwrap()
                    .strip_prefix("DevTools listening on ")
                    .map(str::to_owned)
            })
            .expect("Chromium did not start");
        // Whatever it says later must not fill the pipe.
        std::thread::spawn(move || lines.for_each(drop));
        Self {
            child,
            endpoint,
            profile,
        }
    }

    /// A page of its own.
    pub fn open(&mut self, address: &str) -> Page {
        let authority = self.endpoint.trim_start_matches("ws://");
        let host = authority.split('/').next().unwrap();
        let stream = TcpStream::connect(host).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(30)))
            .unwrap();
        let (socket, _) = tungstenite::client(self.endpoint.as_str(), stream).unwrap();
        let mut page = Page {
            socket,
            session: None,
            next: 0,
        };
        let target = page.call("Target.createTarget", json!({ "url": address }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        let attached = page.call("Target.attachToTarget", attach);
        page.session = attached["sessionId"].as_str().map(str::to_owned);
        page
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        let _ = std::fs::remove_dir_all(&self.profile);
    }
}

/// A page in a browser.
pub struct Page {
    socket: WebSocket<TcpStream>,
    session: Option<String>,
    next: u64,
}

impl Page {
    fn call(&mut self, method: &str, params: Value) -> Value {
        self.ask(method, params)
            .unwrap_or_else(|error| panic!("{method}: {error}"))
    }

    /// The answer of the browser, or its error.
    fn ask(&mut self, method: &str, params: Value) -> Result<Value, Value> {
        self.next += 1;
        let mut message = json!({ "id": self.next, "method": method, "params": params });
        if let Some(session) = &self.session {
            message["sessionId"] = json!(session);
        }
        self.socket
            .send(Message::text(message.to_string()))
            .unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else {
                continue;
            };
            let mut answer: Value = serde_json::from_str(text.as_str()).unwrap();
            if answer["id"] == self.next {
                return match answer["error"].take() {
                    Value::Null => Ok(answer["result"].take()),
                    error => Err(error),
                };
            }
        }
    }

    /// Evaluates an expression of JavaScript.
    pub fn run(&mut self, expression: &str) -> Value {
        self.evaluate(expression)
            .unwrap_or_else(|error| panic!("{expression}: {error}"))
    }

    fn evaluate(&mut self, expression: &str) -> Result<Value, Value> {
        let params = json!({ "expression": expression, "returnByValue": true });
        let mut result = self.ask("Runtime.evaluate", params)?;
        assert!(
            result["exceptionDetails"].is_null(),
            "{expression}: {result}"
        );
        Ok(result["result"]["value"].take())
    }

    /// Chooses a file in an input for files.
    pub fn choose_file(&mut self, id: &str, file: &Path) {
        let params = json!({ "expression": format!("document.getElementById('{id}')") });
        let input = self.call("Runtime.evaluate", params);
        let object = &input["result"]["objectId"];
        let params = json!({ "objectId": object, "files": [file.canonicalize().unwrap()] });
        self.call("DOM.setFileInputFiles", params);
    }

    pub fn truth(&mut self, expression: &str) -> bool {
        self.run(&format!("!!({expression})")).as_bool().unwrap()
    }

    pub fn number(&mut self, expression: &str) -> f64 {
        self.run(expression).as_f64().unwrap()
    }

    pub fn text(&mut self, id: &str) -> String {
        let value = self.run(&format!("document.getElementById('{id}').textContent"));
        value.as_str().unwrap().to_owned()
    }

    /// Waits until an expression is true. While a page is loaded again the browser may have no page to ask: it
    /// answers with an error then, which counts as not true yet.
    pub fn wait(&mut self, expression: &str, patience: Duration) {
        let give_up = Instant::now() + patience;
        let guarded = format!("typeof mcdpr !== 'undefined' && !!({expression})");
        while self.evaluate(&guarded) != Ok(json!(true)) {
            if Instant::now() > give_up {
                let knows = self.run(
                    "JSON.stringify(window.mcdpr && { live: mcdpr.live, may: mcdpr.may, answers: mcdpr.answers, \
                     words: ['verdict-words', 'may', 'trouble'].map(id => document.getElementById(id)?.textContent) })",
                );
                panic!("not true within {patience:?}: {expression}\nthe page knows {knows}");
            }
            std::thread::yield_now();
        }
    }

    /// A key of a real keyboard, down (with what the browser does then) or up.
    pub fn key(&mut self, key: &str, down: bool) {
        let code = match key {
            " " => 32,
            "Escape" => 27,
            "Enter" => 13,
            "ArrowRight" => 39,
            _ => u32::from(key.to_ascii_uppercase().as_bytes()[0]),
        };
        let mut params = json!({
            "type": if down { "keyDown" } else { "keyUp" },
            "key": key,
            "windowsVirtualKeyCode": code,
        });
        if down && (key.len() == 1 || key == "Enter") {
            params["text"] = json!(if key == "Enter" { "\r" } else { key });
        }
        self.call("Input.dispatchKeyEvent", params);
    }

    /// A key that is pressed and let go.
    pub fn press(&mut self, key: &str) {
        self.key(key, true);
        self.key(key, false);
    }

    /// Types into a field, after clearing it.
    pub fn fill(&mut self, id: &str, value: &str) {
        let value = json!(value);
        self.run(&format!(
            "(() => {{ const e = document.getElementById('{id}'); e.focus(); e.value = {value}; \
             e.dispatchEvent(new Event('input', {{ bubbles: true }})); \
             e.dispatchEvent(new Event('change', {{ bubbles: true }})); }})()"
        ));
    }

    /// A click of a real mouse on the element of `selector`, at the point that `at` gives: an expression for
    /// `[x, y]`, CSS pixels, with the element as `e`.
    ///
    /// On a busy machine the page can move between the question and the click, which then goes elsewhere.
    /// Such a click is kept from the page and made again.
    pub fn click_at(&mut self, selector: &str, at: &str) {
        let aim = format!(
            "(() => {{
              if (!window.aims) {{
                window.aims = true;
                for (const type of ['pointerdown', 'mousedown', 'pointerup', 'mouseup', 'click'])
                  window.addEventListener(type, event => {{
                    const aim = window.aim;
                    if (!aim || !event.isTrusted) return;
                    if (type === 'pointerdown') {{
                      const [x, y] = aim.at();
                      aim.hit = aim.e.contains(event.target) && Math.hypot(event.clientX - x, event.clientY - y) < 1;
                    }}
                    // Where it moved between press and release, the click goes to what contains both points.
                    if (!aim.hit || (type === 'click' && !aim.e.contains(event.target))) {{
                      event.preventDefault(); event.stopImmediatePropagation();
                    }} else if (type === 'click') aim.clicked = true;
                  }}, true);
              }}
              const e = document.querySelector('{selector}');
              e.scrollIntoView({{ block: 'center' }});
              window.aim = {{ e, at: () => {at}, hit: false, clicked: false }};
              return window.aim.at();
            }})()"
        );
        for _ in 0..50 {
            let point = self.run(&aim);
            for kind in ["mousePressed", "mouseReleased"] {
                let params = json!({
                    "type": kind, "x": point[0], "y": point[1], "button": "left", "clickCount": 1,
                });
                self.call("Input.dispatchMouseEvent", params);
            }
            // A page that was left by the click has no aim any more.
            if self.truth("!window.aim || window.aim.clicked") {
                self.run("window.aim = null");
                return;
            }
        }
        panic!("{selector} is not where it can be clicked, or is disabled");
    }

    /// A click of a real mouse in the middle of an element.
    pub fn click(&mut self, selector: &str) {
        self.click_at(
            selector,
            "(b => [b.x + b.width / 2, b.y + b.height / 2])(e.getBoundingClientRect())",
        );
    }

    fn mouse(&mut self, kind: &str, selector: &str, at: [f64; 2]) {
        let point = self.run(&format!(
            "(b => [b.x + b.width * {}, b.y + b.height * {}])(document.querySelector('{selector}').getBoundingClientRect())",
            at[0], at[1]
        ));
        let button = if kind == "mouseMoved" { "none" } else { "left" };
        let buttons = i32::from(kind != "mouseReleased");
        let params = json!({
            "type": kind, "x": point[0], "y": point[1], "button": button, "buttons": buttons, "clickCount": 1,
        });
        self.call("Input.dispatchMouseEvent", params);
    }

    /// Presses a real mouse's button at a point of an element (shares of its width and height).
    pub fn press_at(&mut self, selector: &str, at: [f64; 2]) {
        self.run(&format!(
            "document.querySelector('{selector}').scrollIntoView({{ block: 'center' }})"
        ));
        self.mouse("mousePressed", selector, at);
    }

    /// Moves the mouse there, its button held.
    pub fn move_to(&mut self, selector: &str, at: [f64; 2]) {
        self.mouse("mouseMoved", selector, at);
    }

    /// Lets the button go there.
    pub fn let_go(&mut self, selector: &str, at: [f64; 2]) {
        self.mouse("mouseReleased", selector, at);
    }

    /// Moves a real mouse to a point, CSS pixels.
    pub fn mouse_to(&mut self, [x, y]: [f64; 2]) {
        let params = json!({ "type": "mouseMoved", "x": x, "y": y });
        self.call("Input.dispatchMouseEvent", params);
    }

    /// Turns a real wheel at a point; less than 0 is away from the hand.
    pub fn wheel(&mut self, [x, y]: [f64; 2], by: f64) {
        self.mouse_to([x, y]);
        let params = json!({ "type": "mouseWheel", "x": x, "y": y, "deltaX": 0, "deltaY": by });
        self.call("Input.dispatchMouseEvent", params);
    }

    /// Draws a real mouse from one point to another with its button held, CSS pixels.
    pub fn drag(&mut self, from: [f64; 2], to: [f64; 2]) {
        self.mouse_to(from);
        let [middle_x, middle_y] = [0, 1].map(|axis| 0.5 * (from[axis] + to[axis]));
        for (kind, [x, y], buttons) in [
            ("mousePressed", from, 1),
            ("mouseMoved", [middle_x, middle_y], 1),
            ("mouseMoved", to, 1),
            ("mouseReleased", to, 0),
        ] {
            let button = if kind == "mouseMoved" { "none" } else { "left" };
            let params = json!({
                "type": kind, "x": x, "y": y, "button": button, "buttons": buttons, "clickCount": 1,
            });
            self.call("Input.dispatchMouseEvent", params);
        }
    }

    /// Puts two fingers on a touch screen at these points, moves them to the others in steps, and lifts them.
    pub fn two_fingers(&mut self, from: [[f64; 2]; 2], to: [[f64; 2]; 2]) {
        let steps = 8;
        for step in 0..=steps {
            let share = f64::from(step) / f64::from(steps);
            let points: Vec<Value> = from
                .iter()
                .zip(&to)
                .enumerate()
                .map(|(id, (from, to))| {
                    let [x, y] = [0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis]));
                    json!({ "x": x, "y": y, "id": id })
                })
                .collect();
            let kind = if step == 0 { "touchStart" } else { "touchMove" };
            let params = json!({ "type": kind, "touchPoints": points });
            self.call("Input.dispatchTouchEvent", params);
        }
        let params = json!({ "type": "touchEnd", "touchPoints": [] });
        self.call("Input.dispatchTouchEvent", params);
    }

    pub fn resize(&mut self, width: u32, height: u32) {
        let params =
            json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": true });
        self.call("Emulation.setDeviceMetricsOverride", params);
    }

    /// A window of this size on a screen of so many pixels per CSS pixel, in light or dark colours.
    pub fn look(&mut self, [width, height]: [u32; 2], scale: f64, dark: bool) {
        let params = json!({
            "width": width, "height": height, "deviceScaleFactor": scale, "mobile": width < 1000,
        });
        self.call("Emulation.setDeviceMetricsOverride", params);
        let scheme = if dark { "dark" } else { "light" };
        let params = json!({ "features": [{ "name": "prefers-color-scheme", "value": scheme }] });
        self.call("Emulation.setEmulatedMedia", params);
    }

    /// A picture of the page, PNG in base64.
    pub fn screenshot(&mut self) -> String {
        let answer = self.call("Page.captureScreenshot", json!({ "format": "png" }));
        answer["data"].as_str().unwrap().to_owned()
    }
}

/// Where the page shows the tool, world, mm.
pub fn tool_mm(page: &mut Page) -> [f64; 3] {
    [0, 1, 2].map(|axis| page.number(&format!("mcdpr.live.pose.tool_m[{axis}] * 1e3")))
}

/// Between two places, mm.
pub fn distance_mm(a: [f64; 3], b: [f64; 3]) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| (a - b).powi(2));
    squares.sum::<f64>().sqrt()
}
