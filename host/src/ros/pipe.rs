//! The process that speaks DDS: its lines, and what happens when it ends.
//!
//! `ros/src/lines.rs` has the other end of the lines.

use crate::record::ros2::Encoded;
use serde::{Deserialize, Serialize};
use std::io::{self, BufRead as _, BufReader, Write as _};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Lines that wait for the process: a second of them. More are dropped.
const QUEUE: usize = 1024;
/// How long a line is waited for before the process is looked after.
const LOOK: Duration = Duration::from_millis(100);
/// Time from the end of the process to its next start, which doubles up to the second.
const AGAIN: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(30)];
/// How long the process may take to end after its input.
const ENDING: Duration = Duration::from_secs(2);
/// Bytes of the header before a message in CDR, which DDS adds by itself.
const HEADER: usize = 4;

/// A line to the process.
#[derive(Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum ToNode<'a> {
    Node {
        name: &'a str,
    },
    Writer {
        id: usize,
        topic: String,
        kind: String,
        keep: bool,
    },
    Service {
        id: usize,
        name: &'a str,
        kind: &'a str,
    },
    Sample {
        id: usize,
        data: String,
    },
    Reply {
        call: u64,
        data: String,
    },
}

impl ToNode<'_> {
    /// A message of the topic with this number.
    pub(super) fn sample(id: usize, message: &Encoded) -> Self {
        let data = hex(&message.data);
        ToNode::Sample { id, data }
    }

    pub(super) fn line(&self) -> String {
        // A text and numbers can always be written.
        serde_json::to_string(self).unwrap_or_default()
    }
}

/// A line from the process.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Heard {
    Call {
        service: usize,
        call: u64,
        data: String,
    },
}

/// A call of a service.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Call {
    /// The service's number.
    pub(super) service: usize,
    /// CDR without a header.
    pub(super) data: Vec<u8>,
    number: u64,
    /// Which start of the process: a reply to a caller of an earlier one goes nowhere.
    start: u64,
}

/// A line, and for which start of the process it is; none: for whichever runs.
type Line = (String, Option<u64>);

/// How the process is started.
#[derive(Debug, Clone)]
pub(crate) struct Program {
    /// Its file.
    pub(crate) path: PathBuf,
    /// Its arguments.
    pub(crate) arguments: Vec<String>,
}

/// The way to the process. Clones lead to the same.
#[derive(Debug, Clone)]
pub(crate) struct Outlet {
    sender: SyncSender<Line>,
}

impl Outlet {
    /// Sends a line if there is room for it, and never waits.
    pub(super) fn send(&self, line: &ToNode<'_>) {
        let _ = self.sender.try_send((line.line(), None));
    }

    /// Replies to a call, with CDR that has its header.
    pub(super) fn reply(&self, call: &Call, message: &[u8]) {
        let line = ToNode::Reply {
            call: call.number,
            data: hex(message),
        };
        let _ = self.sender.try_send((line.line(), Some(call.start)));
    }
}

/// The process, kept running until this is dropped.
pub(crate) struct Pipe {
    outlet: Outlet,
    over: Arc<AtomicBool>,
    child: Running,
    keeper: Option<JoinHandle<()>>,
}

/// The process, while lines are sent to it.
type Running = Arc<Mutex<Option<Child>>>;

impl Pipe {
    /// Starts the process, sends it `greeting` (at each start), and gives its calls to `called`, on another thread.
    ///
    /// # Errors
    /// If it cannot be started.
    pub(crate) fn start(
        program: Program,
        greeting: Vec<String>,
        called: impl Fn(&Outlet, Call) + Send + Sync + 'static,
    ) -> io::Result<Self> {
        let (sender, receiver) = sync_channel(QUEUE);
        let outlet = Outlet { sender };
        let over = Arc::new(AtomicBool::new(false));
        let child = Running::default();
        let first = spawn(&program)?;
        let keeper = Keeper {
            program,
            greeting,
            receiver,
            outlet: outlet.clone(),
            called: Arc::new(called),
            over: Arc::clone(&over),
            child: Arc::clone(&child),
            start: 0,
        };
        let keeper = std::thread::Builder::new()
            .name("ros".to_owned())
            .spawn(move || keeper.keep(first))?;
        Ok(Self {
            outlet,
            over,
            child,
            keeper: Some(keeper),
        })
    }

    /// The way to the process.
    pub(crate) fn outlet(&self) -> Outlet {
        self.outlet.clone()
    }
}

impl Drop for Pipe {
    fn drop(&mut self) {
        self.over.store(true, Ordering::SeqCst);
        if let Some(keeper) = self.keeper.take() {
            // A process that reads nothing blocks the keeper in a write: only its end frees the keeper.
            let until = Instant::now() + ENDING;
            while !keeper.is_finished() && Instant::now() < until {
                std::thread::sleep(LOOK / 10);
            }
            if !keeper.is_finished()
                && let Some(child) = locked(&self.child).as_mut()
            {
                let _ = child.kill();
            }
            // One that panicked has said so.
            let _ = keeper.join();
        }
    }
}

fn locked(child: &Running) -> MutexGuard<'_, Option<Child>> {
    child.lock().unwrap_or_else(PoisonError::into_inner)
}

fn spawn(program: &Program) -> io::Result<Child> {
    let mut command = Command::new(&program.path);
    // Ctrl-C in a terminal goes to this program alone, which ends the other by its input.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    command
        .args(&program.arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
}

/// Executes a call.
type Called = dyn Fn(&Outlet, Call) + Send + Sync;

/// Keeps the process running.
struct Keeper {
    program: Program,
    greeting: Vec<String>,
    receiver: Receiver<Line>,
    outlet: Outlet,
    called: Arc<Called>,
    over: Arc<AtomicBool>,
    child: Running,
    /// Number of the start.
    start: u64,
}

impl Keeper {
    fn keep(mut self, first: Child) {
        let [mut pause, longest] = AGAIN;
        let mut next: io::Result<Child> = Ok(first);
        while !self.over.load(Ordering::SeqCst) {
            self.start += 1;
            let begun = Instant::now();
            let reason = match next {
                Ok(child) => self.attend(child),
                Err(error) => error.to_string(),
            };
            if self.over.load(Ordering::SeqCst) {
                return;
            }
            // A process that ran for longer than the longest pause was well.
            if begun.elapsed() > longest {
                [pause, _] = AGAIN;
            }
            eprintln!(
                "warning: the ROS side ended ({reason}); the robot goes on without it, it starts again in {} s",
                pause.as_secs()
            );
            self.skip(pause);
            pause = (pause * 2).min(longest);
            next = spawn(&self.program);
        }
    }

    /// Drops what comes, for a while.
    fn skip(&self, time: Duration) {
        let until = Instant::now() + time;
        while Instant::now() < until && !self.over.load(Ordering::SeqCst) {
            let _ = self.receiver.recv_timeout(LOOK);
        }
    }

    /// Sends lines until the process or this program ends; returns why.
    fn attend(&self, mut child: Child) -> String {
        let (Some(mut to), Some(from)) = (child.stdin.take(), child.stdout.take()) else {
            return end(child, None);
        };
        let (outlet, called, start) = (self.outlet.clone(), Arc::clone(&self.called), self.start);
        let listener = std::thread::Builder::new()
            .name("calls".to_owned())
            .spawn(move || {
                for line in BufReader::new(from).lines().map_while(Result::ok) {
                    match serde_json::from_str(&line) {
                        Ok(heard) => called(&outlet, Call::of(heard, start)),
                        Err(error) => eprintln!("warning: the ROS side said: {line}: {error}"),
                    }
                }
            });
        if let Err(error) = listener {
            return end(child, Some(error));
        }
        *locked(&self.child) = Some(child);
        let greeting = self.greeting.iter().try_for_each(|line| put(&mut to, line));
        let outcome = greeting.and_then(|()| self.pass(&mut to));
        drop(to);
        let child = locked(&self.child).take();
        child.map_or_else(String::new, |child| end(child, outcome.err()))
    }

    fn pass(&self, to: &mut ChildStdin) -> io::Result<()> {
        while !self.over.load(Ordering::SeqCst) {
            match self.receiver.recv_timeout(LOOK) {
                // A reply to a caller of an earlier start: it is gone.
                Ok((_, Some(start))) if start != self.start => {}
                Ok((line, _)) => put(to, &line)?,
                Err(RecvTimeoutError::Timeout) if self.has_ended()? => return Ok(()),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
            }
        }
        Ok(())
    }
}

impl Keeper {
    fn has_ended(&self) -> io::Result<bool> {
        let mut child = locked(&self.child);
        let status = child.as_mut().map(Child::try_wait).transpose()?;
        Ok(status.is_none_or(|status| status.is_some()))
    }
}

fn put(to: &mut ChildStdin, line: &str) -> io::Result<()> {
    to.write_all(line.as_bytes())?;
    to.write_all(b"\n")
}

/// Waits for the end of a process whose input has ended; returns how it ended.
fn end(mut child: Child, why: Option<io::Error>) -> String {
    let until = Instant::now() + ENDING;
    let status = loop {
        match child.try_wait() {
            Ok(None) if Instant::now() < until => std::thread::sleep(LOOK / 10),
            Ok(None) => {
                let _ = child.kill();
                break child.wait().map(|status| status.to_string());
            }
            Ok(Some(status)) => break Ok(status.to_string()),
            Err(error) => break Err(error),
        }
    };
    match (status, why) {
        (Ok(status), _) => status,
        (Err(_), Some(error)) | (Err(error), None) => error.to_string(),
    }
}

impl Call {
    fn of(heard: Heard, start: u64) -> Self {
        let Heard::Call {
            service,
            call,
            data,
        } = heard;
        Self {
            service,
            data: from_hex(&data),
            number: call,
            start,
        }
    }
}

fn hex(message: &[u8]) -> String {
    let body = message.get(HEADER..).unwrap_or_default();
    let mut digits = String::with_capacity(body.len() * 2);
    for byte in body {
        for half in [byte >> 4, byte & 15] {
            digits.extend(char::from_digit(u32::from(half), 16));
        }
    }
    digits
}

/// Bytes of digits; what are none ends them.
fn from_hex(digits: &str) -> Vec<u8> {
    let value = |digit: &u8| {
        char::from(*digit)
            .to_digit(16)
            .and_then(|d| u8::try_from(d).ok())
    };
    let pairs = digits.as_bytes().chunks(2).map(|pair| match pair {
        [high, low] => Some((value(high)? << 4) | value(low)?),
        _ => None,
    });
    pairs.map_while(|byte| byte).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;

    const DEADLINE: Duration = Duration::from_secs(60);

    #[cfg(unix)]
    fn shell(script: &str) -> Program {
        Program {
            path: "/bin/sh".into(),
            arguments: vec!["-c".to_owned(), script.to_owned()],
        }
    }

    /// Gives the greeting's line back as a call, and ends at the second line.
    #[cfg(unix)]
    const ECHO: &str = r#"read line; echo "$line"; read line"#;

    #[cfg(unix)]
    #[test]
    fn a_process_that_ends_is_started_again_and_old_replies_go_nowhere() {
        let (sender, calls) = channel();
        let greeting = r#"{"call":{"service":2,"call":7,"data":"0aff"}}"#.to_owned();
        let pipe = Pipe::start(shell(ECHO), vec![greeting], move |_, call| {
            let _ = sender.send(call);
        })
        .unwrap();
        let first = calls.recv_timeout(DEADLINE).unwrap();
        assert_eq!((first.service, &first.data[..]), (2, &[0x0A, 0xFF][..]));
        // It ends at this line, and is there again.
        pipe.outlet().reply(&first, &[0, 1, 0, 0, 5]);
        let second = calls.recv_timeout(DEADLINE).unwrap();
        assert_ne!(first, second);
        // To the caller of the first start: it does not end the second.
        pipe.outlet().reply(&first, &[0, 1, 0, 0, 5]);
        assert!(calls.recv_timeout(3 * AGAIN[0]).is_err());
        pipe.outlet().reply(&second, &[0, 1, 0, 0, 5]);
        assert!(calls.recv_timeout(DEADLINE).is_ok());
    }

    #[cfg(unix)]
    #[test]
    fn a_process_that_does_not_read_holds_nobody() {
        let pipe = Pipe::start(shell("exec sleep 1000"), Vec::new(), |_, _| {}).unwrap();
        let begun = Instant::now();
        let big = Encoded {
            kind: "std_msgs/String",
            data: vec![0; 10_000],
        };
        for _ in 0..3 * QUEUE {
            pipe.outlet().send(&ToNode::sample(0, &big));
        }
        drop(pipe);
        // Nothing waits for a process that reads nothing; the time is that of 30 MB of digits, and of
        // the two seconds that the process may take to end.
        assert!(begun.elapsed() < Duration::from_secs(20));
    }

    #[test]
    fn digits_are_bytes_behind_the_header() {
        assert_eq!(hex(&[0, 1, 0, 0, 0x0A, 0xFF]), "0aff");
        assert_eq!(from_hex("0aff"), [0x0A, 0xFF]);
        assert_eq!(from_hex("0aéf"), [0x0A]);
    }
}
