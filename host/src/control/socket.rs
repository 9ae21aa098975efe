//! Orders from another process of the same user, over a socket in the user's runtime folder.
//!
//! One line of JSON each way: an [`Order`], or `{"order":"view"}`, and an [`Answer`]. The folder is
//! accessible only to its owner, and so is the socket.

use super::{Handle, Order, View};
use miette::Diagnostic;
use serde::{Deserialize, Serialize};
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;
use thiserror::Error;

/// Time that an order may take until the board has confirmed it.
const CONFIRM: Duration = Duration::from_secs(3);
/// A caller that sends nothing for this long is disconnected.
const CALLER: Duration = Duration::from_secs(5);
/// An order is shorter than this, bytes.
const LONGEST_ORDER: u64 = 4096;

/// Why another process cannot be reached, or cannot reach this one.
#[derive(Debug, Error, Diagnostic)]
pub enum SocketError {
    /// No process moves this robot.
    #[error("no running mcdpr moves {robot}")]
    #[diagnostic(
        code(mcdpr::control::nobody),
        help(
            "give --on and --robot as for the command that moves it; a board without a host stops by itself"
        )
    )]
    Nobody {
        /// The robot.
        robot: String,
    },
    /// The folder for sockets belongs to another user, or is accessible to others.
    #[error("{} is not a folder of this user alone", path.display())]
    #[diagnostic(
        code(mcdpr::control::folder),
        help("remove it, or set XDG_RUNTIME_DIR to a folder of your own")
    )]
    Folder {
        /// The folder.
        path: PathBuf,
    },
    /// Another process moves this robot already.
    #[error("another mcdpr moves {robot} already")]
    #[diagnostic(
        code(mcdpr::control::taken),
        help("stop it first, with `mcdpr stop` and the same --on")
    )]
    Taken {
        /// Which robot.
        robot: String,
    },
    /// The order was refused.
    #[error("refused: {reason}")]
    #[diagnostic(code(mcdpr::control::refused))]
    Refused {
        /// Why.
        reason: String,
    },
    /// The system failed.
    #[error("the socket {} failed", path.display())]
    #[diagnostic(code(mcdpr::control::system))]
    System {
        /// The socket.
        path: PathBuf,
        /// How.
        source: std::io::Error,
    },
}

/// The answer.
#[derive(Debug, Serialize, Deserialize)]
struct Answer {
    /// Why the order was refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    refused: Option<String>,
    view: View,
}

/// The folder of the sockets; created, and checked to be private to this user.
///
/// # Errors
/// [`SocketError::Folder`], [`SocketError::System`].
pub(crate) fn runtime_dir() -> Result<PathBuf, SocketError> {
    let path = match std::env::var_os("XDG_RUNTIME_DIR").filter(|dir| !dir.is_empty()) {
        Some(dir) => PathBuf::from(dir).join("mcdpr"),
        None => {
            let user = std::env::var("USER").unwrap_or_default();
            std::env::temp_dir().join(format!("mcdpr-{}", plain(&user)))
        }
    };
    let system = |source| SocketError::System {
        path: path.clone(),
        source,
    };
    match std::fs::DirBuilder::new().mode(0o700).create(&path) {
        Ok(()) => {}
        Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
        Err(error) => return Err(system(error)),
    }
    if !is_ours_alone(&path).map_err(system)? {
        return Err(SocketError::Folder { path });
    }
    Ok(path)
}

/// Whether a folder belongs to this user and is not accessible to others. Only checks: in a folder
/// of another user nothing may be created or followed. A link is not a folder.
fn is_ours_alone(path: &Path) -> std::io::Result<bool> {
    let found = std::fs::symlink_metadata(path)?;
    Ok(found.is_dir() && found.mode() & 0o077 == 0 && found.uid() == this_user()?)
}

/// The user id of this process: that of a pipe which it creates, and which is not on a disk.
fn this_user() -> std::io::Result<u32> {
    let (reader, _) = std::io::pipe()?;
    let end = std::fs::File::from(std::os::fd::OwnedFd::from(reader));
    Ok(end.metadata()?.uid())
}

/// The name of a robot's socket: its port, or the simulator of a robot file.
fn key(on: &str, robot: &str) -> String {
    if on == "sim" || on == "chip" {
        format!("{on}-{}", plain(robot))
    } else {
        let port = std::fs::canonicalize(on).unwrap_or_else(|_| PathBuf::from(on));
        format!("port-{}", plain(&port.to_string_lossy()))
    }
}

/// Letters, digits and dashes of a name, limited to the length of a socket's path.
fn plain(name: &str) -> String {
    let safe = |c: char| if c.is_ascii_alphanumeric() { c } else { '-' };
    let all: Vec<char> = name.chars().map(safe).collect();
    // The path of a socket has 108 bytes at most (Linux): of a long name the end is kept.
    let keep = all.len().saturating_sub(48);
    all.iter().skip(keep).collect()
}

/// Accepts orders of other processes for a handle, until it is dropped.
#[derive(Debug)]
pub struct Server {
    path: PathBuf,
    ending: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Starts to listen for the robot on `on` (a port, `sim` or `chip`) with the robot file
    /// `robot`. There may be several simulated robots; a port has one owner.
    ///
    /// # Errors
    /// [`SocketError`].
    pub fn start(on: &str, robot: &str, handle: Handle) -> Result<Self, SocketError> {
        let dir = runtime_dir()?;
        let name = key(on, robot);
        let mut path = dir.join(format!("{name}.sock"));
        if on == "sim" || on == "chip" {
            path = dir.join(format!("{name}.{}.sock", std::process::id()));
        }
        let system = |source| SocketError::System {
            path: path.clone(),
            source,
        };
        // A socket without a listener was left by a process that was killed.
        if path.exists() {
            if UnixStream::connect(&path).is_ok() {
                return Err(SocketError::Taken {
                    robot: on.to_owned(),
                });
            }
            std::fs::remove_file(&path).map_err(system)?;
        }
        let listener = UnixListener::bind(&path).map_err(system)?;
        let owner_only = std::fs::Permissions::from_mode(0o600);
        std::fs::set_permissions(&path, owner_only).map_err(system)?;
        let ending = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&ending);
        let thread = std::thread::Builder::new()
            .name("orders".to_owned())
            .spawn(move || {
                for stream in listener.incoming() {
                    if ended.load(Ordering::SeqCst) {
                        return;
                    }
                    let (Ok(stream), handle) = (stream, handle.clone()) else {
                        continue;
                    };
                    // A slow caller must not delay a stop.
                    let _ = std::thread::Builder::new()
                        .name("order".to_owned())
                        .spawn(move || serve(stream, &handle));
                }
            })
            .map_err(system)?;
        Ok(Self {
            path,
            ending,
            thread: Some(thread),
        })
    }

    /// The socket.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.ending.store(true, Ordering::SeqCst);
        // The listener blocks: a last connection wakes it.
        let woken = UnixStream::connect(&self.path).is_ok();
        let _ = std::fs::remove_file(&self.path);
        if let Some(thread) = self.thread.take().filter(|_| woken) {
            let _ = thread.join();
        }
    }
}

fn serve(stream: UnixStream, handle: &Handle) {
    let _ = stream.set_read_timeout(Some(CALLER));
    let _ = stream.set_write_timeout(Some(CALLER));
    let Ok(mut writer) = stream.try_clone() else {
        return;
    };
    // A caller that sends without end must not fill the memory.
    let mut reader = BufReader::new(stream.take(LONGEST_ORDER));
    let mut line = String::new();
    if reader.read_line(&mut line).is_err() || line.is_empty() {
        return;
    }
    let answer = Answer {
        refused: obey(&line, handle).err(),
        view: handle.view(),
    };
    if let Ok(mut text) = serde_json::to_string(&answer) {
        text.push('\n');
        let _ = writer.write_all(text.as_bytes());
    }
}

fn obey(line: &str, handle: &Handle) -> Result<(), String> {
    let value: serde_json::Value =
        serde_json::from_str(line).map_err(|error| format!("this is not an order: {error}"))?;
    if value.get("order").and_then(|order| order.as_str()) == Some("view") {
        return Ok(());
    }
    let order: Order =
        serde_json::from_value(value).map_err(|error| format!("this is not an order: {error}"))?;
    let ticket = handle.order(order);
    handle
        .wait(ticket, CONFIRM)
        .unwrap_or_else(|| Err("the order was not taken within 3 s".to_owned()))
}

/// Sockets with a listener, for the robot on `on`.
///
/// # Errors
/// As [`runtime_dir`].
pub(crate) fn live_sockets(on: &str, robot: &str) -> Result<Vec<PathBuf>, SocketError> {
    let dir = runtime_dir()?;
    let name = key(on, robot);
    let entries = std::fs::read_dir(&dir).map_err(|source| SocketError::System {
        path: dir.clone(),
        source,
    })?;
    let mut found: Vec<_> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| {
            let file = path.file_name().unwrap_or_default().to_string_lossy();
            let ours = file.strip_prefix(&name);
            ours.is_some_and(|rest| rest.starts_with('.') && rest.ends_with(".sock"))
                && UnixStream::connect(path).is_ok()
        })
        .collect();
    found.sort();
    Ok(found)
}

/// Gives an order to a process by its socket, or only reads its view (`None`).
///
/// # Errors
/// [`SocketError::Refused`] with the reason, [`SocketError::System`].
pub fn call(path: &Path, order: Option<Order>) -> Result<View, SocketError> {
    let system = |source| SocketError::System {
        path: path.to_owned(),
        source,
    };
    let mut stream = UnixStream::connect(path).map_err(system)?;
    stream
        .set_read_timeout(Some(CONFIRM + CALLER))
        .map_err(system)?;
    let mut text = match order {
        Some(order) => serde_json::to_string(&order),
        None => Ok(r#"{"order":"view"}"#.to_owned()),
    }
    .map_err(|error| system(error.into()))?;
    text.push('\n');
    stream.write_all(text.as_bytes()).map_err(system)?;
    let mut line = String::new();
    BufReader::new(stream)
        .read_line(&mut line)
        .map_err(system)?;
    let answer: Answer = serde_json::from_str(&line).map_err(|error| system(error.into()))?;
    match answer.refused {
        Some(reason) => Err(SocketError::Refused { reason }),
        None => Ok(answer.view),
    }
}

/// Gives an order to every process that moves the robot on `on` (several may simulate the same
/// robot), and returns their views.
///
/// # Errors
/// [`SocketError::Nobody`] if no program listens; otherwise the first that failed, after all got the
/// order.
pub(crate) fn call_all(
    on: &str,
    robot: &str,
    order: Option<Order>,
) -> Result<Vec<View>, SocketError> {
    let sockets = live_sockets(on, robot)?;
    if sockets.is_empty() {
        return Err(SocketError::Nobody {
            robot: if on == "sim" || on == "chip" {
                format!("a simulated {robot}")
            } else {
                format!("the robot on {on}")
            },
        });
    }
    let views: Vec<_> = sockets.iter().map(|path| call(path, order)).collect();
    views.into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_order_reaches_the_handle_and_its_outcome_comes_back() {
        let handle = Handle::new();
        let on = format!("/nowhere/order-{}", std::process::id());
        let server = Server::start(&on, "r", handle.clone()).unwrap();
        assert!(matches!(
            Server::start(&on, "r", handle.clone()),
            Err(SocketError::Taken { .. })
        ));
        let mode = std::fs::metadata(server.path()).unwrap().mode();
        assert_eq!(mode & 0o077, 0, "others can reach the socket: {mode:o}");
        let feeder = handle.clone();
        let thread = std::thread::spawn(move || {
            let (done, refused) = (Order::Pause, Order::Resume);
            for _ in 0..2 {
                let (ticket, order) = loop {
                    if let Some(taken) = feeder.take() {
                        break taken;
                    }
                    std::thread::yield_now();
                };
                let outcome = if order == refused {
                    Err("it is moving".to_owned())
                } else {
                    assert_eq!(order, done);
                    Ok(())
                };
                feeder.publish(|view| view.paused = true);
                feeder.done(ticket, outcome);
            }
        });
        let views = call_all(&on, "r", Some(Order::Pause)).unwrap();
        assert!(views.first().unwrap().paused);
        let error = call_all(&on, "r", Some(Order::Resume)).unwrap_err();
        assert_eq!(error.to_string(), "refused: it is moving");
        thread.join().unwrap();
        assert!(call_all(&on, "r", None).unwrap().first().unwrap().paused);
        drop(server);
        assert!(matches!(
            call_all(&on, "r", None),
            Err(SocketError::Nobody { .. })
        ));
    }

    /// A folder that others can enter may contain links to files of ours under any name.
    #[test]
    fn a_folder_of_others_is_refused_and_nothing_in_it_is_touched() {
        let path = std::env::temp_dir().join(format!("mcdpr-theirs-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        let victim = path.join("victim");
        std::fs::write(&victim, "precious").unwrap();
        let trap = path.join(format!(".{}", std::process::id()));
        std::os::unix::fs::symlink(&victim, &trap).unwrap();
        let open = |mode| {
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
        };
        open(0o777);
        assert!(!is_ours_alone(&path).unwrap());
        open(0o700);
        assert!(is_ours_alone(&path).unwrap());
        assert_eq!(std::fs::read_to_string(&victim).unwrap(), "precious");
        assert!(trap.is_symlink());
        let link = path.join("link");
        std::os::unix::fs::symlink(&path, &link).unwrap();
        assert!(!is_ours_alone(&link).unwrap());
        std::fs::remove_dir_all(path).unwrap();
    }

    #[test]
    fn rubbish_is_refused_and_a_dead_socket_is_replaced() {
        let handle = Handle::new();
        let on = format!("/nowhere/dead-{}", std::process::id());
        let server = Server::start(&on, "r", handle.clone()).unwrap();
        let mut stream = UnixStream::connect(server.path()).unwrap();
        stream.write_all(b"{\"order\":\"dance\"}\n").unwrap();
        let mut line = String::new();
        BufReader::new(stream).read_line(&mut line).unwrap();
        assert!(line.contains("this is not an order"), "{line}");
        assert_eq!(handle.take(), None);
        let path = server.path().to_owned();
        drop(server);
        // A killed process leaves a socket file without a listener.
        drop(UnixListener::bind(&path).unwrap());
        assert!(path.exists());
        let again = Server::start(&on, "r", handle).unwrap();
        assert!(call(again.path(), None).is_ok());
    }
}
