//! The listener: the page, and a WebSocket for each viewer.

use super::feed::{Feed, describe};
use super::http::{Request, answer};
use super::orders::Orders;
use crate::robot::Robot;
use miette::Diagnostic;
use serde_json::{Value, json};
use std::io::{self, Write as _};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use thiserror::Error;
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Message, WebSocket};

/// Viewers at once.
const VIEWERS: usize = 16;
/// Time between two pictures of the robot: 60 a second.
const FRAME: Duration = Duration::from_micros(16_600);
/// Longest wait for an order, before the next look whether a picture is due.
const LOOK: Duration = Duration::from_millis(4);
/// A viewer that takes nothing for this long is gone.
const STUCK: Duration = Duration::from_secs(2);
/// Bytes of a message that a viewer may send.
const MOST: usize = 4096;

/// Why there is no page.
#[derive(Debug, Error, Diagnostic)]
pub enum ServeError {
    /// Somebody has the port.
    #[error("port {port} is in use by another program")]
    #[diagnostic(
        code(mcdpr::serve::port),
        help(
            "is another `mcdpr serve` running? Choose another port with --port, or 0 for any free one"
        )
    )]
    Taken {
        /// The port.
        port: u16,
    },
    /// The system refused.
    #[error("the page cannot be served on port {port}: {reason}")]
    #[diagnostic(code(mcdpr::serve::system))]
    System {
        /// The port.
        port: u16,
        /// What the system says.
        reason: String,
    },
}

/// Takes the orders of viewers who may give them.
pub trait Desk: Send + Sync + 'static {
    /// An order, by its name and numbers; gives what became of it, or why it is refused. Must
    /// return soon: the viewer's connection waits for it.
    ///
    /// # Errors
    /// The reason of a refusal, in words.
    fn order(&self, name: &str, message: &Value) -> Result<(), String>;

    /// Orders that can be given, for the page to show.
    fn orders(&self) -> Vec<&'static str>;
}

struct Shared {
    feed: Feed,
    desk: Arc<dyn Desk>,
    robot: Value,
    orders: Orders,
    port: u16,
    ended: AtomicBool,
    viewers: AtomicUsize,
    /// Pages that ever looked, to tell them apart.
    pages: AtomicU64,
}

/// A page that is being served; ends when it is dropped.
pub struct Server {
    shared: Arc<Shared>,
    listener: Option<JoinHandle<()>>,
}

impl Server {
    /// Serves on loopback; port 0 takes a free one.
    ///
    /// # Errors
    /// [`ServeError::Taken`], [`ServeError::System`].
    pub fn start(
        port: u16,
        token: Option<String>,
        robot: &Robot,
        feed: Feed,
        desk: Arc<dyn Desk>,
    ) -> Result<Self, ServeError> {
        let system = |error: io::Error| match error.kind() {
            io::ErrorKind::AddrInUse => ServeError::Taken { port },
            _ => ServeError::System {
                port,
                reason: error.to_string(),
            },
        };
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        let listener = TcpListener::bind(address).map_err(system)?;
        let bound = listener.local_addr().map_err(system)?.port();
        let shared = Arc::new(Shared {
            feed,
            desk,
            robot: describe(robot),
            orders: Orders::new(token),
            port: bound,
            ended: AtomicBool::new(false),
            viewers: AtomicUsize::new(0),
            pages: AtomicU64::new(0),
        });
        let for_thread = Arc::clone(&shared);
        let thread = std::thread::Builder::new()
            .name("page".to_owned())
            .spawn(move || listen(&listener, &for_thread))
            .map_err(system)?;
        Ok(Self {
            shared,
            listener: Some(thread),
        })
    }

    /// The port.
    #[must_use]
    pub fn port(&self) -> u16 {
        self.shared.port
    }

    /// The address for those who only look.
    #[must_use]
    pub fn address(&self) -> String {
        format!("http://127.0.0.1:{}/", self.shared.port)
    }

    /// The address for those who may give orders. The token stands behind a `#`: browsers do not
    /// send that part anywhere.
    #[must_use]
    pub fn address_with_token(&self) -> String {
        format!("{}#token={}", self.address(), self.shared.orders.token())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::SeqCst);
        // Wakes the listener.
        drop(TcpStream::connect((Ipv4Addr::LOCALHOST, self.shared.port)));
        if let Some(thread) = self.listener.take() {
            let _ = thread.join();
        }
    }
}

fn listen(listener: &TcpListener, shared: &Arc<Shared>) {
    for stream in listener.incoming() {
        if shared.ended.load(Ordering::SeqCst) {
            return;
        }
        let Ok(stream) = stream else { continue };
        if shared.viewers.fetch_add(1, Ordering::SeqCst) >= VIEWERS {
            shared.viewers.fetch_sub(1, Ordering::SeqCst);
            let mut stream = stream;
            let text = "too many viewers: close a page that is not needed";
            let _ = answer(&mut stream, "503 Service Unavailable", "text/plain", text);
            continue;
        }
        let guest = Arc::clone(shared);
        let spawned = std::thread::Builder::new()
            .name("viewer".to_owned())
            .spawn(move || {
                // A viewer that is gone is no error of the robot's.
                let _ = receive(stream, &guest);
                guest.viewers.fetch_sub(1, Ordering::SeqCst);
            });
        if spawned.is_err() {
            shared.viewers.fetch_sub(1, Ordering::SeqCst);
        }
    }
}

fn receive(mut stream: TcpStream, shared: &Shared) -> io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(STUCK))?;
    stream.set_write_timeout(Some(STUCK))?;
    let request = Request::read(&mut stream, STUCK)?;
    if !request.is_for(shared.port) {
        let text = "this page is only for browsers on this machine, by its own address";
        return answer(&mut stream, "403 Forbidden", "text/plain", text);
    }
    if request.method != "GET" {
        return answer(
            &mut stream,
            "405 Method Not Allowed",
            "text/plain",
            "only GET",
        );
    }
    match (request.path.as_str(), request.header("sec-websocket-key")) {
        ("/", _) => answer(&mut stream, "200 OK", "text/html", &super::page()),
        ("/ws", Some(key)) => {
            let accept = tungstenite::handshake::derive_accept_key(key.as_bytes());
            write!(
                stream,
                "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
                 Sec-WebSocket-Accept: {accept}\r\n\r\n"
            )?;
            view(stream, shared)
        }
        _ => answer(
            &mut stream,
            "404 Not Found",
            "text/plain",
            "there is only /",
        ),
    }
}

/// Shows the robot to one viewer until either goes.
fn view(stream: TcpStream, shared: &Shared) -> io::Result<()> {
    stream.set_read_timeout(Some(LOOK))?;
    let config = WebSocketConfig::default()
        .max_message_size(Some(MOST))
        .max_frame_size(Some(MOST));
    let mut socket = WebSocket::from_raw_socket(stream, Role::Server, Some(config));
    let send = |socket: &mut WebSocket<TcpStream>, value: &Value| {
        socket
            .send(Message::text(value.to_string()))
            .map_err(io::Error::other)
    };
    let hello = json!({
        "type": "hello",
        "robot": shared.robot,
        "orders": shared.desk.orders(),
        "version": env!("CARGO_PKG_VERSION"),
    });
    send(&mut socket, &hello)?;
    shared.feed.viewer(true);
    let page = shared.pages.fetch_add(1, Ordering::SeqCst);
    let outcome = keep_showing(page, &mut socket, shared, &send);
    shared.orders.leave(page);
    shared.feed.viewer(false);
    outcome?;
    let _ = socket.close(None);
    let _ = socket.flush();
    Ok(())
}

/// Sends what is new, and takes orders, until either side goes.
fn keep_showing(
    page: u64,
    socket: &mut WebSocket<TcpStream>,
    shared: &Shared,
    send: &impl Fn(&mut WebSocket<TcpStream>, &Value) -> io::Result<()>,
) -> io::Result<()> {
    let (mut revision, mut plan, mut logged, mut pictures) = (0, 0, 0, 0);
    let mut sent = Instant::now();
    let mut due = sent;
    while !shared.ended.load(Ordering::SeqCst) {
        // An order is answered as soon as it comes, a picture when it is due.
        match socket.read() {
            Ok(Message::Text(text)) => {
                let (desk, feed) = (shared.desk.as_ref(), &shared.feed);
                let reply = shared.orders.obey(page, text.as_str(), desk, feed);
                send(socket, &reply)?;
            }
            Ok(Message::Close(_)) => return Ok(()),
            Ok(_) => {}
            Err(tungstenite::Error::Io(error))
                if matches!(
                    error.kind(),
                    io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut
                ) => {}
            Err(error) => return Err(io::Error::other(error)),
        }
        let now = Instant::now();
        if now < due {
            continue;
        }
        if let Some((number, new)) = shared.feed.plan_after(plan) {
            plan = number;
            let points: Vec<_> = new.points.iter().step_by(5).map(|p| p.tool_m).collect();
            let message = json!({ "type": "plan", "duration_s": new.duration_s, "tool_m": points });
            send(socket, &message)?;
        }
        if let Some((number, new)) = shared.feed.picture_after(pictures) {
            pictures = number;
            send(socket, &new.about)?;
            let bytes = Message::binary(new.png.clone());
            socket.send(bytes).map_err(io::Error::other)?;
        }
        let lines = shared.feed.log_after(logged);
        if let Some((last, ..)) = lines.last() {
            logged = *last;
            send(socket, &json!({ "type": "log", "lines": lines }))?;
        }
        let (live, age_s) = shared.feed.now();
        let new = live.revision != revision;
        // Twice a second the age of old data is told, too.
        if new || sent.elapsed() > Duration::from_millis(400) {
            revision = live.revision;
            sent = now;
            // From when it was due: lateness must not add up.
            due = (due + FRAME).max(now);
            let mut message = serde_json::to_value(&live)?;
            message["type"] = json!("live");
            message["age_s"] = json!(age_s);
            send(socket, &message)?;
        }
    }
    Ok(())
}
