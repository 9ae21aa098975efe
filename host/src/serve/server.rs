//! The listener: the page, and a WebSocket for each viewer.

use super::feed::{Feed, describe};
use super::http::{Request, answer};
use super::orders::Orders;
use crate::robot::Robot;
use mcdpr_twin::notices::Seen;
use mcdpr_twin::viewer::{Message as News, Viewer};
use miette::Diagnostic;
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::io::{self, Write as _};
use std::net::{IpAddr, Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use thiserror::Error;
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Message, WebSocket};

/// Greatest number of viewers.
const VIEWERS: usize = 16;
/// Time between two pictures of the robot: 60 a second.
const FRAME: Duration = Duration::from_micros(16_600);
/// Longest wait for an order, before the next check whether a picture is due.
const LOOK: Duration = Duration::from_millis(4);
/// A viewer that accepts nothing for this long is disconnected.
const STUCK: Duration = Duration::from_secs(2);
/// A request must be complete within this time.
const HANDSHAKE: Duration = Duration::from_secs(2);
/// Timeout of one read of a request, so that it can be aborted in time.
const READ: Duration = Duration::from_millis(100);
/// Greatest number of connections whose request is not complete; of more, the oldest is closed.
const HALF_OPEN: usize = 32;
/// Bytes of a message that a viewer may send.
const MOST: usize = 64 * 1024;

/// Why the page cannot be served.
#[derive(Debug, Error, Diagnostic)]
pub enum ServeError {
    /// Another program has the port.
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
        /// The system's message.
        reason: String,
    },
}

/// Executes the orders of viewers with permission.
pub trait Desk: Send + Sync + 'static {
    /// An order, by its name and arguments; returns its answer (null without one), or why it is
    /// refused. Must return soon: the viewer's connection waits for it.
    ///
    /// # Errors
    /// The reason of a refusal, in words.
    fn order(&self, name: &str, message: &Value) -> Result<Value, String>;

    /// Available orders, for the page.
    fn orders(&self) -> Vec<&'static str>;

    /// A document besides the page, by its path: media type and text, or why there is none. `None` if there is
    /// nothing at that path. It may take a second; only the viewer that asks waits.
    fn document(&self, _path: &str) -> Option<Result<(&'static str, String), String>> {
        None
    }
}

struct Shared {
    feed: Feed,
    desk: Arc<dyn Desk>,
    robot: Value,
    orders: Orders,
    /// The address that is listened on.
    host: IpAddr,
    port: u16,
    ended: AtomicBool,
    viewers: AtomicUsize,
    /// Connections whose request is not complete, the oldest first.
    half_open: Mutex<VecDeque<(u64, TcpStream)>>,
    /// Number of pages so far, to distinguish them.
    pages: AtomicU64,
}

/// A page that is being served; ends when it is dropped.
pub struct Server {
    shared: Arc<Shared>,
    listener: Option<JoinHandle<()>>,
}

impl Server {
    /// Serves on this machine's own address; port 0 takes a free one.
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
        let local = IpAddr::from(Ipv4Addr::LOCALHOST);
        Self::start_on(local, port, token, robot, feed, desk)
    }

    /// As [`Server::start`], on an address that other machines may reach.
    ///
    /// # Errors
    /// [`ServeError::Taken`], [`ServeError::System`].
    pub(crate) fn start_on(
        host: IpAddr,
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
        let address = SocketAddr::from((host, port));
        let listener = TcpListener::bind(address).map_err(system)?;
        let bound = listener.local_addr().map_err(system)?.port();
        let shared = Arc::new(Shared {
            feed,
            desk,
            robot: describe(robot),
            orders: Orders::new(token),
            host,
            port: bound,
            ended: AtomicBool::new(false),
            viewers: AtomicUsize::new(0),
            half_open: Mutex::default(),
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

    /// The token for orders.
    #[must_use]
    pub(crate) fn token(&self) -> &str {
        self.shared.orders.token()
    }

    /// An address at which this machine reaches it.
    fn reached_at(&self) -> IpAddr {
        if self.shared.host.is_unspecified() {
            IpAddr::from(Ipv4Addr::LOCALHOST)
        } else {
            self.shared.host
        }
    }

    /// The address for read-only viewers.
    #[must_use]
    pub fn address(&self) -> String {
        format!(
            "http://{}/",
            SocketAddr::from((self.reached_at(), self.shared.port))
        )
    }

    /// The address for viewers who may give orders. The token follows a `#`: browsers do not send
    /// that part.
    #[must_use]
    pub(crate) fn address_with_token(&self) -> String {
        format!("{}#token={}", self.address(), self.shared.orders.token())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::SeqCst);
        // Wakes the listener.
        drop(TcpStream::connect((self.reached_at(), self.shared.port)));
        if let Some(thread) = self.listener.take() {
            let _ = thread.join();
        }
    }
}

fn listen(listener: &TcpListener, shared: &Arc<Shared>) {
    for (number, stream) in (0..).zip(listener.incoming()) {
        if shared.ended.load(Ordering::SeqCst) {
            return;
        }
        let Ok(stream) = stream else { continue };
        if shared.began(number, &stream).is_err() {
            continue;
        }
        let guest = Arc::clone(shared);
        let spawned = std::thread::Builder::new()
            .name("viewer".to_owned())
            .spawn(move || {
                // A viewer that has disconnected is not an error of the robot.
                let _ = receive(number, stream, &guest);
                guest.asked(number);
            });
        if spawned.is_err() {
            shared.asked(number);
        }
    }
}

impl Shared {
    /// A new connection. A silent one must not block others: if there are too many of them, the
    /// oldest is closed.
    fn began(&self, number: u64, stream: &TcpStream) -> io::Result<()> {
        let known = stream.try_clone()?;
        let mut half_open = self
            .half_open
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        half_open.push_back((number, known));
        if half_open.len() > HALF_OPEN
            && let Some((_, oldest)) = half_open.pop_front()
        {
            let _ = oldest.shutdown(Shutdown::Both);
        }
        Ok(())
    }

    /// Its request is complete, or it was closed.
    fn asked(&self, number: u64) {
        let mut half_open = self
            .half_open
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        half_open.retain(|(known, _)| *known != number);
    }
}

fn receive(number: u64, mut stream: TcpStream, shared: &Shared) -> io::Result<()> {
    // Small messages, 60 a second: Nagle's algorithm would collect them.
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(READ))?;
    stream.set_write_timeout(Some(STUCK))?;
    let request = Request::read(&mut stream, HANDSHAKE)?;
    shared.asked(number);
    // Before any answer: a page of another site must not reach the robot through a browser.
    if !request.is_for(shared.port, !shared.host.is_loopback()) {
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
            // Counted first: two connections at one moment cannot both take the last place.
            if shared.viewers.fetch_add(1, Ordering::SeqCst) >= VIEWERS {
                shared.viewers.fetch_sub(1, Ordering::SeqCst);
                let text = "too many viewers: close a page that is not needed";
                return answer(&mut stream, "503 Service Unavailable", "text/plain", text);
            }
            let outcome = upgrade(stream, key, shared);
            shared.viewers.fetch_sub(1, Ordering::SeqCst);
            outcome
        }
        (path, _) => match shared.desk.document(path) {
            Some(Ok((kind, text))) => answer(&mut stream, "200 OK", kind, &text),
            Some(Err(reason)) => answer(&mut stream, "404 Not Found", "text/plain", &reason),
            None => answer(
                &mut stream,
                "404 Not Found",
                "text/plain",
                "there is only /",
            ),
        },
    }
}

/// Turns a connection into a viewer's WebSocket.
fn upgrade(mut stream: TcpStream, key: &str, shared: &Shared) -> io::Result<()> {
    let accept = tungstenite::handshake::derive_accept_key(key.as_bytes());
    write!(
        stream,
        "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
         Sec-WebSocket-Accept: {accept}\r\n\r\n"
    )?;
    view(stream, shared)
}

/// Serves one viewer until either side ends.
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
    let hello = Viewer::hello(&shared.robot, &shared.desk.orders());
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

/// Sends new data, and takes orders, until either side ends.
fn keep_showing(
    page: u64,
    socket: &mut WebSocket<TcpStream>,
    shared: &Shared,
    send: &impl Fn(&mut WebSocket<TcpStream>, &Value) -> io::Result<()>,
) -> io::Result<()> {
    let mut viewer = Viewer::default();
    let mut seen = Seen::default();
    let mut sent = Instant::now();
    let mut due = sent;
    while !shared.ended.load(Ordering::SeqCst) {
        // An order is answered as soon as it comes, a picture is sent when it is due.
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
        for message in viewer.news(&shared.feed) {
            match message {
                News::Text(text) => send(socket, &text)?,
                News::Picture(picture) => {
                    send(socket, &picture.about)?;
                    let bytes = Message::binary(picture.png.clone());
                    socket.send(bytes).map_err(io::Error::other)?;
                }
            }
        }
        let other = shared.feed.notices().since(&mut seen);
        for message in &other.messages {
            send(socket, message)?;
        }
        if let Some(mut live) = other.live {
            // Another program has the robot, and this one is not heard meanwhile.
            if other.live_is_new || sent.elapsed() > Duration::from_millis(400) {
                sent = now;
                due = (due + FRAME).max(now);
                live["age_s"] = json!(other.live_age_s);
                send(socket, &live)?;
            }
            continue;
        }
        // The age of old data is sent every 400 ms, too.
        let anyway = sent.elapsed() > Duration::from_millis(400);
        if let Some(live) = viewer.live(&shared.feed, anyway) {
            sent = now;
            // From its due time: delays must not add up.
            due = (due + FRAME).max(now);
            send(socket, &live)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read as _;

    struct Nothing;

    impl Desk for Nothing {
        fn order(&self, _: &str, _: &Value) -> Result<Value, String> {
            Ok(Value::Null)
        }

        fn orders(&self) -> Vec<&'static str> {
            Vec::new()
        }
    }

    fn server() -> Server {
        let robot = Robot::built_in("paper-optimistic").unwrap();
        Server::start(0, None, &robot, crate::serve::feed(), Arc::new(Nothing)).unwrap()
    }

    /// A viewer by the real handshake; its first message.
    fn viewer(port: u16) -> (WebSocket<TcpStream>, String) {
        let stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).unwrap();
        stream.set_read_timeout(Some(STUCK)).unwrap();
        let address = format!("ws://127.0.0.1:{port}/ws");
        let (mut socket, _) = tungstenite::client(address, stream).unwrap();
        let first = socket.read().unwrap().into_text().unwrap().to_string();
        (socket, first)
    }

    #[test]
    fn half_open_connections_keep_nobody_out_and_are_closed() {
        let server = server();
        let port = server.port();
        let silent = |begin: &str| {
            let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).unwrap();
            stream.write_all(begin.as_bytes()).unwrap();
            stream
        };
        let mut half: Vec<_> = (0..VIEWERS)
            .map(|_| silent("GET /ws HTTP/1.1\r\n"))
            .collect();
        let began = Instant::now();
        let (_socket, hello) = viewer(port);
        assert!(hello.contains("\"hello\""), "{hello}");
        assert!(began.elapsed() < HANDSHAKE, "it had to wait for the others");
        // Far more than may be half open: the newest viewer still gets in.
        half.extend((0..3 * HALF_OPEN).map(|_| silent("")));
        let (_other, hello) = viewer(port);
        assert!(hello.contains("\"hello\""), "{hello}");
        // Incomplete ones are closed.
        for stream in &mut half {
            stream.set_read_timeout(Some(2 * HANDSHAKE)).unwrap();
            let mut byte = [0];
            // Closed or reset; not a time-out.
            match stream.read(&mut byte) {
                Ok(count) => assert_eq!(count, 0),
                Err(error) => assert_eq!(error.kind(), io::ErrorKind::ConnectionReset),
            }
        }
    }

    #[test]
    fn more_viewers_than_places_are_refused_with_the_reason() {
        let server = server();
        let port = server.port();
        let viewers: Vec<_> = (0..VIEWERS).map(|_| viewer(port)).collect();
        let stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).unwrap();
        let refused = tungstenite::client(format!("ws://127.0.0.1:{port}/ws"), stream);
        let error = refused.err().map(|error| error.to_string()).unwrap();
        assert!(error.contains("503"), "{error}");
        drop(viewers);
    }
}
