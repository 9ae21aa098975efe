//! A command that runs: its output, its questions, its end.

use super::command::Command;
use super::output::{Judged, Lines, Piece, address_of, is_address};
use super::relay::Relay;
use super::stopping::{Measure, next};
use crate::run::interrupted;
use crate::serve::Feed;
use serde_json::{Value, json};
use std::io::{self, Read, Write as _};
use std::process::{ChildStdin, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Longest wait for output, before the next look at everything else.
const LOOK: Duration = Duration::from_millis(10);
/// Bytes of output that are read at once.
const CHUNK: usize = 4096;
/// Output that comes after the end of a command is waited for so long.
const LATE: Duration = Duration::from_secs(1);

/// A piece of output, and whether it is of a result (standard output).
type Said = (Piece, bool);

/// A running command.
pub(super) struct Child {
    process: Mutex<std::process::Child>,
    input: Mutex<Option<ChildStdin>>,
    said: Mutex<Receiver<Said>>,
    shared: Mutex<Shared>,
    id: &'static str,
    run: u64,
    feed: Feed,
    began: Instant,
}

#[derive(Default)]
struct Shared {
    question: Option<String>,
    relay: Option<Arc<Relay>>,
    /// The last measure to stop it, and when it was taken.
    stopping: Option<(Measure, Instant)>,
}

fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Child {
    /// Starts this program with the words of a command.
    ///
    /// # Errors
    /// The system's.
    pub(super) fn start(
        id: &'static str,
        command: &Command,
        live: bool,
        run: u64,
        feed: Feed,
    ) -> io::Result<Self> {
        let mut start = std::process::Command::new(std::env::current_exe()?);
        start
            .args(&command.words)
            .args(["--for-page", &std::process::id().to_string()])
            .args(live.then_some(["--serve", "0"]).into_iter().flatten())
            .env("NO_COLOR", "1")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        // Ctrl-C in the terminal of this program is for this program, which then stops the command.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut start, 0);
        let mut process = start.spawn()?;
        let (sender, said) = channel();
        if let Some(output) = process.stdout.take() {
            read(output, true, sender.clone())?;
        }
        if let Some(errors) = process.stderr.take() {
            read(errors, false, sender)?;
        }
        Ok(Self {
            input: Mutex::new(process.stdin.take()),
            process: Mutex::new(process),
            said: Mutex::new(said),
            shared: Mutex::default(),
            id,
            run,
            feed,
            began: Instant::now(),
        })
    }

    /// What it asks.
    pub(super) fn question(&self) -> Option<String> {
        lock(&self.shared).question.clone()
    }

    /// Answers its question.
    pub(super) fn answer(&self, text: &str) -> Result<(), String> {
        let mut shared = lock(&self.shared);
        if shared.question.is_none() {
            return Err("it asks nothing now".to_owned());
        }
        if text.len() > 100 || text.chars().any(char::is_control) {
            return Err("an answer is one short line".to_owned());
        }
        let mut input = lock(&self.input);
        let input = input.as_mut().ok_or("it takes no answers any more")?;
        let written = writeln!(input, "{text}").and_then(|()| input.flush());
        written.map_err(|error| format!("the answer did not arrive: {error}"))?;
        shared.question = None;
        drop(shared);
        self.note(&format!("answer: {text}"));
        Ok(())
    }

    /// Stops it: at once by an order, if it takes orders.
    pub(super) fn stop(&self) {
        let mut shared = lock(&self.shared);
        // Every press of the button reaches the command; the measures begin with the first.
        if let Some(relay) = &shared.relay {
            relay.send(&json!({ "order": "stop" }));
        }
        if shared.stopping.is_some() {
            return;
        }
        shared.stopping = Some((Measure::Ordered, Instant::now()));
        let has_page = shared.relay.is_some();
        drop(shared);
        // A question that nobody will answer ends what asks it.
        *lock(&self.input) = None;
        if has_page {
            self.note(Measure::Ordered.words());
        }
    }

    /// Passes an order to it.
    pub(super) fn pass(&self, order: &Value) -> Result<(), String> {
        let relay = lock(&self.shared).relay.clone();
        let relay = relay.filter(|relay| relay.is_open());
        let none = || "this command takes no such order; Stop ends it".to_owned();
        relay.ok_or_else(none)?.order(order)
    }

    fn note(&self, text: &str) {
        self.feed.notices().line(self.run, "note", text);
    }

    /// Shows its output until it has ended; `changed` is called when it asks something. Returns its result, or the
    /// reason of its failure.
    pub(super) fn until_it_ends(&self, changed: impl Fn()) -> Result<Value, Value> {
        let mut judged = Judged::default();
        let said = lock(&self.said);
        let status = loop {
            match said.recv_timeout(LOOK) {
                Ok(piece) => {
                    if self.take(piece, &mut judged) {
                        changed();
                    }
                }
                // It has closed its outputs: it ends.
                Err(RecvTimeoutError::Disconnected) => std::thread::park_timeout(LOOK),
                Err(RecvTimeoutError::Timeout) => {}
            }
            // This program ends: so does its command.
            if interrupted() && lock(&self.shared).stopping.is_none() {
                self.stop();
            }
            self.go_on_stopping();
            if let Ok(Some(status)) = lock(&self.process).try_wait() {
                break status;
            }
        };
        while let Ok(piece) = said.recv_timeout(LATE) {
            self.take(piece, &mut judged);
        }
        let (relay, stopped) = {
            let mut shared = lock(&self.shared);
            shared.question = None;
            (shared.relay.take(), shared.stopping.is_some())
        };
        if let Some(relay) = relay {
            relay.end();
        }
        self.ended(status, stopped, &judged)
    }

    fn ended(&self, status: ExitStatus, stopped: bool, judged: &Judged) -> Result<Value, Value> {
        let seconds = self.began.elapsed().as_secs_f64();
        let code = status.code();
        let words = code.map_or("by a signal".to_owned(), |code| format!("with code {code}"));
        self.note(&format!("{} ended {words} after {seconds:.1} s", self.id));
        let result = json!(judged.result());
        if status.success() {
            return Ok(json!({ "result": result, "seconds": seconds }));
        }
        let (reason, next) = judged.failure(code);
        let (reason, next) = if stopped {
            let reason = format!("stopped from the page; it ended {words}");
            (reason, "run it again when you want to go on".to_owned())
        } else {
            (reason, next)
        };
        Err(json!({ "reason": reason, "next": next, "result": result, "seconds": seconds }))
    }

    /// Takes a piece of output; returns whether there is a question now.
    fn take(&self, (piece, is_result): Said, judged: &mut Judged) -> bool {
        let line = match piece {
            Piece::Question(question) => {
                self.feed.notices().line(self.run, "ask", &question);
                lock(&self.shared).question = Some(question);
                return true;
            }
            Piece::Line(line) => line,
        };
        if let Some((host, token)) = address_of(&line) {
            // A command without a live page still runs.
            match Relay::start(host, token, self.id, self.feed.clone()) {
                Ok(relay) => {
                    let mut shared = lock(&self.shared);
                    if shared.stopping.is_some() {
                        relay.send(&json!({ "order": "stop" }));
                    }
                    shared.relay = Some(Arc::new(relay));
                }
                Err(error) => self.note(&format!("it cannot be shown live: {error}")),
            }
        }
        if is_address(&line) || !judged.take(&line, is_result) {
            return false;
        }
        let kind = if is_result { "out" } else { "err" };
        self.feed.notices().line(self.run, kind, &line);
        false
    }

    fn go_on_stopping(&self) {
        let mut shared = lock(&self.shared);
        let Some((last, at)) = shared.stopping else {
            return;
        };
        let relay = shared.relay.as_ref();
        let orders = relay.is_some_and(|relay| relay.is_open());
        let answered = relay.is_some_and(|relay| relay.has_stopped());
        let Some(measure) = next(last, at.elapsed(), answered, orders || answered) else {
            return;
        };
        shared.stopping = Some((measure, Instant::now()));
        drop(shared);
        let mut process = lock(&self.process);
        // One that has ended has no number any more.
        if matches!(process.try_wait(), Ok(None)) && signal(&mut process, measure).is_ok() {
            self.note(measure.words());
        }
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        // Only after an error of this program: the command must not be left alone with a robot.
        let mut process = lock(&self.process);
        if matches!(process.try_wait(), Ok(None)) {
            let _ = signal(&mut process, Measure::Interrupted);
        }
    }
}

#[cfg(unix)]
fn signal(process: &mut std::process::Child, measure: Measure) -> io::Result<()> {
    use nix::sys::signal::{Signal, kill};
    use nix::unistd::Pid;
    match measure {
        Measure::Ordered => return Ok(()),
        Measure::Killed => return process.kill(),
        Measure::Interrupted | Measure::Again => {}
    }
    let number = i32::try_from(process.id()).map_err(io::Error::other)?;
    kill(Pid::from_raw(number), Signal::SIGINT).map_err(io::Error::from)
}

#[cfg(not(unix))]
fn signal(process: &mut std::process::Child, measure: Measure) -> io::Result<()> {
    // There is no interrupt: the board stops a robot whose program has ended.
    if measure > Measure::Ordered {
        return process.kill();
    }
    Ok(())
}

/// Reads an output on a thread of its own, so that the command never waits for this program.
fn read(mut from: impl Read + Send + 'static, is_result: bool, to: Sender<Said>) -> io::Result<()> {
    let reading = move || {
        let (mut lines, mut bytes) = (Lines::default(), [0; CHUNK]);
        loop {
            let pieces = match from.read(&mut bytes) {
                Ok(0) | Err(_) => break,
                Ok(count) => lines.take(bytes.get(..count).unwrap_or_default()),
            };
            for piece in pieces {
                if to.send((piece, is_result)).is_err() {
                    return;
                }
            }
        }
        if let Some(piece) = lines.end() {
            let _ = to.send((piece, is_result));
        }
    };
    std::thread::Builder::new()
        .name("output".to_owned())
        .spawn(reading)
        .map(|_| ())
}
