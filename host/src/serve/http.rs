//! The part of HTTP that one page and a WebSocket need.

use std::io::{self, Read, Write};
use std::net::SocketAddr;
use std::time::{Duration, Instant};

/// Most bytes of a request's head.
const MOST: usize = 16 * 1024;

/// A request without a body.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Request {
    pub(super) method: String,
    pub(super) path: String,
    headers: Vec<(String, String)>,
}

impl Request {
    /// Reads a request's head, which must be complete within a time limit, however slowly it
    /// arrives. Reads of `from` must return by themselves before that.
    pub(super) fn read(from: &mut impl Read, patience: Duration) -> io::Result<Self> {
        let began = Instant::now();
        let mut head = Vec::new();
        // Byte by byte: what follows the head is for the WebSocket.
        let mut byte = [0];
        while !head.ends_with(b"\r\n\r\n") {
            if began.elapsed() > patience || head.len() >= MOST {
                return Err(io::ErrorKind::InvalidData.into());
            }
            match from.read(&mut byte) {
                Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
                Ok(_) => head.extend_from_slice(&byte),
                Err(error)
                    if matches!(
                        error.kind(),
                        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut
                    ) => {}
                Err(error) => return Err(error),
            }
        }
        Self::parse(&head).ok_or_else(|| io::ErrorKind::InvalidData.into())
    }

    fn parse(head: &[u8]) -> Option<Self> {
        let text = std::str::from_utf8(head).ok()?;
        let mut lines = text.split("\r\n");
        let mut first = lines.next()?.split(' ');
        let (method, target) = (first.next()?, first.next()?);
        first
            .next()
            .filter(|version| version.starts_with("HTTP/1."))?;
        let headers = lines
            .filter_map(|line| line.split_once(':'))
            .map(|(name, value)| (name.trim().to_ascii_lowercase(), value.trim().to_owned()));
        Some(Self {
            method: method.to_owned(),
            path: target.split('?').next()?.to_owned(),
            headers: headers.collect(),
        })
    }

    /// A header's value; `name` in small letters.
    pub(super) fn header(&self, name: &str) -> Option<&str> {
        let found = self.headers.iter().find(|(known, _)| known == name);
        found.map(|(_, value)| value.as_str())
    }

    /// Whether the browser addresses this server: a page of another site, or a host name that was
    /// redirected to this address, is refused. A server that listens for other machines (`open`) is
    /// addressed by number: names, which somebody else may redirect, are refused.
    pub(super) fn is_for(&self, port: u16, open: bool) -> bool {
        // A foreign name that resolves to this machine (DNS rebinding) is none of these.
        let own = |authority: &str| {
            let local = ["127.0.0.1", "localhost", "[::1]"]
                .iter()
                .any(|host| authority == format!("{host}:{port}"));
            let number = || {
                let address = authority.parse::<SocketAddr>();
                address.is_ok_and(|address| address.port() == port)
            };
            local || (open && number())
        };
        let host = self.header("host").filter(|host| own(host));
        // Browsers send an origin with a WebSocket; other programs send none.
        let origin = self.header("origin").map(|origin| {
            let bare = origin.strip_prefix("http://");
            bare.is_some_and(own) && (!open || bare == host)
        });
        host.is_some() && origin.unwrap_or(true)
    }
}

/// Answers with a body and closes.
pub(super) fn answer(
    to: &mut impl Write,
    status: &str,
    media_type: &str,
    body: &str,
) -> io::Result<()> {
    write!(
        to,
        "HTTP/1.1 {status}\r\nContent-Type: {media_type}; charset=utf-8\r\nContent-Length: {}\r\n\
         Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n\
         Content-Security-Policy: default-src 'none'; style-src 'unsafe-inline'; script-src \
         'unsafe-inline'; img-src data: blob:; connect-src 'self' ws:; frame-ancestors 'none'\r\n\
         Connection: close\r\n\r\n{body}",
        body.len()
    )?;
    to.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(text: &str) -> Option<Request> {
        Request::read(&mut text.as_bytes(), Duration::from_secs(60)).ok()
    }

    #[test]
    fn a_request_is_read_and_rubbish_is_refused() {
        let read =
            request("GET /ws?x=1 HTTP/1.1\r\nHost: localhost:80\r\nUpgrade: websocket\r\n\r\n");
        let read = read.unwrap();
        assert_eq!((read.method.as_str(), read.path.as_str()), ("GET", "/ws"));
        assert_eq!(read.header("upgrade"), Some("websocket"));
        assert!(request("GET /\r\n\r\n").is_none());
        assert!(request("hello").is_none());
        assert!(request(&"x".repeat(MOST + 10)).is_none());
    }

    #[test]
    fn other_sites_are_refused() {
        let ask = |host: &str, origin: &str| {
            let text = format!("GET / HTTP/1.1\r\nHost: {host}\r\n{origin}\r\n");
            request(&text).unwrap().is_for(8650, false)
        };
        assert!(ask("127.0.0.1:8650", ""));
        assert!(ask("localhost:8650", "Origin: http://localhost:8650\r\n"));
        assert!(!ask("evil.example:8650", ""));
        assert!(!ask("127.0.0.1:8650", "Origin: http://evil.example\r\n"));
        assert!(!ask("127.0.0.1:9999", ""));
        assert!(!ask("192.168.0.7:8650", ""));
    }

    #[test]
    fn an_open_server_is_addressed_by_number_only() {
        let ask = |host: &str, origin: &str| {
            let text = format!("GET / HTTP/1.1\r\nHost: {host}\r\n{origin}\r\n");
            request(&text).unwrap().is_for(8650, true)
        };
        assert!(ask(
            "192.168.0.7:8650",
            "Origin: http://192.168.0.7:8650\r\n"
        ));
        assert!(ask("localhost:8650", ""));
        assert!(!ask("robot.example:8650", ""));
        assert!(!ask(
            "192.168.0.7:8650",
            "Origin: http://192.168.0.8:8650\r\n"
        ));
        assert!(!ask("192.168.0.7:9999", ""));
    }
}
