//! The viewer of a command's live page: what the command shows goes on to the viewers of this program, and their
//! orders go to the command.

use crate::serve::Feed;
use serde_json::{Value, json};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, TryRecvError, channel, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use tungstenite::{Message, WebSocket};

/// Longest wait for data, before the next look at orders.
const LOOK: Duration = Duration::from_millis(4);
/// An order that is not answered within this time is reported as in progress.
const ANSWER: Duration = Duration::from_millis(50);

/// Where the outcome of an order goes.
type Answer = SyncSender<Result<(), String>>;

/// An order on its way to the command.
struct Sent {
    order: Value,
    answer: Answer,
}

/// A connection to a command's live page.
pub(super) struct Relay {
    orders: Sender<Sent>,
    open: Arc<AtomicBool>,
    ended: Arc<AtomicBool>,
    /// When the command has answered a stop.
    stopped: Arc<AtomicBool>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Relay {
    /// Connects to the page at `host`, whose orders need `token`.
    pub(super) fn start(
        host: String,
        token: String,
        doing: &'static str,
        feed: Feed,
    ) -> std::io::Result<Self> {
        let (orders, todo) = channel();
        let open = Arc::new(AtomicBool::new(true));
        let ended = Arc::new(AtomicBool::new(false));
        let stopped = Arc::new(AtomicBool::new(false));
        let line = Line {
            token,
            doing,
            feed,
            todo,
            waiting: Vec::new(),
            ended: Arc::clone(&ended),
            stopped: Arc::clone(&stopped),
            camera: None,
            count: 0,
        };
        let still_open = Arc::clone(&open);
        let thread = std::thread::Builder::new()
            .name("step".to_owned())
            .spawn(move || {
                // The command ends when it likes: that is no error of this program.
                let _ = line.keep_on(&host);
                still_open.store(false, Ordering::SeqCst);
            })?;
        Ok(Self {
            orders,
            open,
            ended,
            stopped,
            thread: Mutex::new(Some(thread)),
        })
    }

    /// Whether the command is connected.
    pub(super) fn is_open(&self) -> bool {
        self.open.load(Ordering::SeqCst)
    }

    /// Whether the command has answered a stop.
    pub(super) fn has_stopped(&self) -> bool {
        self.stopped.load(Ordering::SeqCst)
    }

    /// Gives an order without waiting.
    pub(super) fn send(&self, order: &Value) {
        let (answer, _) = sync_channel(1);
        let order = order.clone();
        // A command that has ended needs no order.
        let _ = self.orders.send(Sent { order, answer });
    }

    /// Gives an order; the reason of a refusal.
    pub(super) fn order(&self, order: &Value) -> Result<(), String> {
        let (answer, answered) = sync_channel(1);
        let order = order.clone();
        let gone = |_| "the command does not answer".to_owned();
        self.orders.send(Sent { order, answer }).map_err(gone)?;
        answered.recv_timeout(ANSWER).unwrap_or(Ok(()))
    }

    /// Ends the connection.
    pub(super) fn end(&self) {
        self.ended.store(true, Ordering::SeqCst);
        let thread = self.thread.lock();
        let thread = thread.unwrap_or_else(PoisonError::into_inner).take();
        if let Some(thread) = thread {
            let _ = thread.join();
        }
    }
}

/// The connection, on its own thread.
struct Line {
    token: String,
    /// What the command does, in a word.
    doing: &'static str,
    feed: Feed,
    todo: Receiver<Sent>,
    waiting: Vec<(u64, bool, Answer)>,
    ended: Arc<AtomicBool>,
    stopped: Arc<AtomicBool>,
    /// The text about the picture that follows.
    camera: Option<Value>,
    count: u64,
}

impl Line {
    fn keep_on(mut self, host: &str) -> Result<(), Box<tungstenite::Error>> {
        let stream = TcpStream::connect(host).map_err(|error| Box::new(error.into()))?;
        let failed = |error: std::io::Error| Box::new(tungstenite::Error::Io(error));
        stream.set_nodelay(true).map_err(failed)?;
        let (mut socket, _) = tungstenite::client(format!("ws://{host}/ws"), stream)
            .map_err(|error| failed(std::io::Error::other(error.to_string())))?;
        let _ = socket.get_ref().set_read_timeout(Some(LOOK));
        while !self.ended.load(Ordering::SeqCst) {
            loop {
                match self.todo.try_recv() {
                    Ok(sent) => self.give(sent, &mut socket)?,
                    Err(TryRecvError::Empty) => break,
                    Err(TryRecvError::Disconnected) => return Ok(()),
                }
            }
            match socket.read() {
                Ok(Message::Text(text)) => {
                    if let Ok(message) = serde_json::from_str(text.as_str()) {
                        self.take(message);
                    }
                }
                Ok(Message::Binary(png)) => {
                    if let Some(about) = self.camera.take() {
                        self.feed.show_png(about, png.to_vec());
                    }
                }
                Ok(Message::Close(_)) => return Ok(()),
                Ok(_) => {}
                Err(tungstenite::Error::Io(error))
                    if matches!(
                        error.kind(),
                        std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut
                    ) => {}
                Err(error) => return Err(Box::new(error)),
            }
        }
        Ok(())
    }

    fn give(
        &mut self,
        sent: Sent,
        socket: &mut WebSocket<TcpStream>,
    ) -> Result<(), Box<tungstenite::Error>> {
        let Sent { mut order, answer } = sent;
        self.count += 1;
        order["id"] = json!(self.count);
        order["token"] = json!(self.token);
        let is_stop = order["order"] == "stop";
        self.waiting.push((self.count, is_stop, answer));
        socket
            .send(Message::text(order.to_string()))
            .map_err(Box::new)
    }

    /// A message of the command.
    fn take(&mut self, mut message: Value) {
        match message["type"].as_str() {
            Some("live") => {
                message["task"] = json!(self.doing);
                self.feed.notices().set_live(Some(message));
            }
            Some("plan" | "pick") => self.feed.notices().post(message),
            Some("camera") => self.camera = Some(message),
            Some("log") => {
                let lines = message["lines"].as_array().into_iter().flatten();
                for text in lines.filter_map(|line| line["text"].as_str()) {
                    self.feed.say(text);
                }
            }
            Some("answer") => {
                let id = message["id"].as_u64();
                let Some(place) = self
                    .waiting
                    .iter()
                    .position(|(known, ..)| Some(*known) == id)
                else {
                    return;
                };
                let (_, is_stop, answer) = self.waiting.swap_remove(place);
                if is_stop && message["ok"] == true {
                    self.stopped.store(true, Ordering::SeqCst);
                }
                let outcome = if message["ok"] == true {
                    Ok(())
                } else {
                    Err(message["reason"].as_str().unwrap_or("refused").to_owned())
                };
                // Who gave it may not have waited.
                let _ = answer.try_send(outcome);
            }
            _ => {}
        }
    }
}
