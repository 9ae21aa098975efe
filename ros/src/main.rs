//! The ROS 2 side of `mcdpr ros`: topics and services on DDS, in a process of its own.
//!
//! It knows nothing of robots. Standard input has one JSON document a line ([`lines::Order`]): topics and
//! services to make, samples and replies to send, each as the bytes of its CDR encoding. Standard output has
//! the calls of services ([`lines::Said`]). It ends with its input.

mod info;
mod lines;
mod node;
mod raw;
mod service;

use lines::Order;
use node::{Node, NodeError};
use std::io::BufRead as _;
use std::net::IpAddr;
use std::process::ExitCode;

const USAGE: &str = "usage: mcdpr-ros [--domain N] [--interface IP]...

DDS domain N (0) on these interfaces (all). `mcdpr ros` starts it.";

/// Where to be on the network.
#[derive(Debug, Default, PartialEq, Eq)]
struct Place {
    domain: u16,
    /// Empty: every interface.
    interfaces: Vec<IpAddr>,
}

fn main() -> ExitCode {
    let Some(place) = place(std::env::args().skip(1)) else {
        eprintln!("{USAGE}");
        return ExitCode::from(2);
    };
    match serve(&place) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("mcdpr-ros: {error}");
            ExitCode::FAILURE
        }
    }
}

fn place(mut words: impl Iterator<Item = String>) -> Option<Place> {
    let mut place = Place::default();
    while let Some(word) = words.next() {
        match word.as_str() {
            "--domain" => place.domain = words.next()?.parse().ok()?,
            "--interface" => place.interfaces.push(words.next()?.parse().ok()?),
            _ => return None,
        }
    }
    Some(place)
}

fn serve(place: &Place) -> Result<(), NodeError> {
    let mut node = Node::new(place.domain, &place.interfaces)?;
    for line in std::io::stdin().lock().lines() {
        let line = line.map_err(NodeError::Input)?;
        let order: Order = serde_json::from_str(&line).map_err(|error| NodeError::Line {
            reason: error.to_string(),
            line: line.chars().take(80).collect(),
        })?;
        // A topic that cannot be made ends this process, and is heard of. A sample that cannot be sent is lost,
        // as it would be on a bad network.
        match order {
            Order::Node { name } => node.name(&name)?,
            Order::Writer {
                id,
                topic,
                kind,
                keep,
            } => node.writer(id, &topic, &kind, keep)?,
            Order::Service { id, name, kind } => node.service(id, &name, &kind)?,
            Order::Sample { id, data } => node.sample(id, data.0),
            Order::Reply { call, data } => node.reply(call, data.0),
        }
        // Lines come 50 times a second.
        node.answer();
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(words: &[&str]) -> Option<Place> {
        place(words.iter().map(|word| (*word).to_owned()))
    }

    #[test]
    fn the_place_is_read_and_nothing_else() {
        assert_eq!(of(&[]), Some(Place::default()));
        let found = of(&["--domain", "7", "--interface", "127.0.0.1"]);
        let wanted = Place {
            domain: 7,
            interfaces: vec![IpAddr::from([127, 0, 0, 1])],
        };
        assert_eq!(found, Some(wanted));
        for wrong in [
            &["--domain"][..],
            &["--domain", "x"],
            &["--interface", "lo"],
            &["more"],
        ] {
            assert_eq!(of(wrong), None, "{wrong:?}");
        }
    }
}
