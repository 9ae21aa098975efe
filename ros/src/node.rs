//! One node of ROS 2: its topics and services on DDS.

use crate::info::{self, Entities};
use crate::lines::{Hex, Said};
use crate::raw::{AsIs, Raw};
use crate::service::{Caller, received};
use futures::StreamExt as _;
use rustdds::dds::result::CreateError;
use rustdds::no_key::{DataReader, DataWriter};
use rustdds::policy::{Durability, History, Reliability};
use rustdds::{
    DataWriterStatus, DomainParticipant, DomainParticipantBuilder, Duration, GUID, Publisher,
    QosPolicies, QosPolicyBuilder, RTPSEntity as _, StatusEvented as _, Subscriber, TopicKind,
};
use std::collections::{BTreeMap, HashMap};
use std::io::Write as _;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Calls that wait for their reply; older ones are forgotten, and their callers wait in vain.
const CALLS: usize = 256;
/// Samples that are kept for a subscriber that is behind: the depth of ROS 2's default profile.
const DEPTH: i32 = 10;
/// How long a reply waits for the reader of its caller to be known.
const MATCHING: std::time::Duration = std::time::Duration::from_secs(1);
/// How long a write may wait for a slow subscriber, ms.
const BLOCKING_MS: i64 = 100;

/// Why the node cannot go on.
#[derive(Debug)]
pub(crate) enum NodeError {
    /// Standard input.
    Input(std::io::Error),
    /// A line of it.
    Line {
        /// What is wrong.
        reason: String,
        /// Its beginning.
        line: String,
    },
    /// DDS refuses something.
    Dds {
        /// What was to be made.
        what: String,
        /// Why not.
        reason: CreateError,
    },
    /// The system has no thread.
    Thread(std::io::Error),
}

impl std::fmt::Display for NodeError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Input(error) => write!(f, "standard input: {error}"),
            Self::Line { reason, line } => write!(f, "not a line of mcdpr's: {reason}: {line}"),
            Self::Dds { what, reason } => write!(f, "DDS refuses {what}: {reason}"),
            Self::Thread(error) => write!(f, "no thread for a service: {error}"),
        }
    }
}

fn dds(what: &str) -> impl FnOnce(CreateError) -> NodeError + '_ {
    move |reason| NodeError::Dds {
        what: what.to_owned(),
        reason,
    }
}

/// The profile of ROS 2 for topics and services: reliable, the last ten; `keep` for late subscribers.
fn profile(keep: bool, depth: i32) -> QosPolicies {
    let durability = if keep {
        Durability::TransientLocal
    } else {
        Durability::Volatile
    };
    QosPolicyBuilder::new()
        .reliability(Reliability::Reliable {
            max_blocking_time: Duration::from_millis(BLOCKING_MS),
        })
        .durability(durability)
        .history(History::KeepLast { depth })
        .build()
}

/// Calls without a reply yet: service and caller.
#[derive(Default)]
struct Calls {
    next: u64,
    waiting: BTreeMap<u64, Asked>,
}

/// A call: its service, who called, and the writer of the request.
struct Asked {
    service: u32,
    caller: Caller,
    from: GUID,
}

impl Calls {
    fn add(&mut self, asked: Asked) -> u64 {
        self.next += 1;
        self.waiting.insert(self.next, asked);
        if self.waiting.len() > CALLS {
            self.waiting.pop_first();
        }
        self.next
    }
}

/// The writer of a service's replies, and their known readers.
struct Replies {
    writer: DataWriter<Raw, AsIs>,
    readers: Vec<GUID>,
}

impl Replies {
    /// Notes a reader of the replies.
    fn look(&mut self) {
        while let Some(status) = self.writer.try_recv_status() {
            let DataWriterStatus::PublicationMatched {
                current, reader, ..
            } = status
            else {
                continue;
            };
            self.readers.retain(|known| *known != reader);
            if current.count_change() > 0 {
                self.readers.push(reader);
            }
        }
    }

    /// Whether a program that sent a request reads the replies.
    fn reach(&self, from: GUID) -> bool {
        self.readers
            .iter()
            .any(|reader| reader.prefix == from.prefix)
    }
}

/// A reply on its way.
struct Answer {
    asked: Asked,
    data: Raw,
    until: Instant,
}

/// A node with its topics and services.
pub(crate) struct Node {
    participant: DomainParticipant,
    publisher: Publisher,
    subscriber: Subscriber,
    info: DataWriter<Raw, AsIs>,
    entities: Entities,
    writers: HashMap<u32, DataWriter<Raw, AsIs>>,
    replies: HashMap<u32, Replies>,
    answers: Vec<Answer>,
    calls: Arc<Mutex<Calls>>,
}

impl Node {
    /// A node without topics, in a domain, on these interfaces (all, if none is named).
    ///
    /// # Errors
    /// Where DDS cannot be started there.
    pub(crate) fn new(domain: u16, interfaces: &[IpAddr]) -> Result<Self, NodeError> {
        let mut builder = DomainParticipantBuilder::new(domain);
        if !interfaces.is_empty() {
            builder = builder.with_only_networks(interfaces.iter().copied());
        }
        let participant = builder.build().map_err(dds("a participant"))?;
        let qos = profile(false, DEPTH);
        let publisher = participant.create_publisher(&qos);
        let publisher = publisher.map_err(dds("a publisher"))?;
        let subscriber = participant.create_subscriber(&qos);
        let subscriber = subscriber.map_err(dds("a subscriber"))?;
        let info = write_to(
            &participant,
            &publisher,
            (info::TOPIC, info::KIND),
            profile(true, 1),
        )?;
        Ok(Self {
            participant,
            publisher,
            subscriber,
            info,
            entities: Entities::default(),
            writers: HashMap::new(),
            replies: HashMap::new(),
            answers: Vec::new(),
            calls: Arc::default(),
        })
    }

    /// Names the node.
    pub(crate) fn name(&mut self, name: &str) -> Result<(), NodeError> {
        name.clone_into(&mut self.entities.name);
        self.announce();
        Ok(())
    }

    /// Publishes a topic.
    pub(crate) fn writer(
        &mut self,
        id: u32,
        topic: &str,
        kind: &str,
        keep: bool,
    ) -> Result<(), NodeError> {
        let qos = profile(keep, DEPTH);
        let writer = write_to(&self.participant, &self.publisher, (topic, kind), qos)?;
        self.entities.writers.push(writer.guid());
        self.writers.insert(id, writer);
        self.announce();
        Ok(())
    }

    /// Offers a service; its calls go to standard output.
    pub(crate) fn service(&mut self, id: u32, name: &str, kind: &str) -> Result<(), NodeError> {
        let qos = profile(false, DEPTH);
        let (topic, kind_of_reply) = (format!("rr/{name}Reply"), format!("{kind}_Response_"));
        let reply = write_to(
            &self.participant,
            &self.publisher,
            (&topic, &kind_of_reply),
            qos.clone(),
        )?;
        let topic = format!("rq/{name}Request");
        let made = self.participant.create_topic(
            topic.clone(),
            format!("{kind}_Request_"),
            &qos,
            TopicKind::NoKey,
        );
        let made = made.map_err(dds(&topic))?;
        let reader = self
            .subscriber
            .create_datareader_no_key::<Raw, AsIs>(&made, Some(qos));
        let reader = reader.map_err(dds(&topic))?;
        self.entities.writers.push(reply.guid());
        self.entities.readers.push(reader.guid());
        let readers = Vec::new();
        self.replies.insert(
            id,
            Replies {
                writer: reply,
                readers,
            },
        );
        let calls = Arc::clone(&self.calls);
        std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || listen(id, reader, &calls))
            .map_err(NodeError::Thread)?;
        self.announce();
        Ok(())
    }

    /// Sends a sample; one that cannot be sent is lost.
    pub(crate) fn sample(&self, id: u32, data: Raw) {
        if let Some(writer) = self.writers.get(&id)
            && let Err(error) = writer.write(data, None)
        {
            eprintln!("mcdpr-ros: a sample of topic {id} is lost: {error:?}");
        }
    }

    /// Answers a call.
    pub(crate) fn reply(&mut self, call: u64, data: Raw) {
        let mut calls = self.calls.lock().unwrap_or_else(PoisonError::into_inner);
        let asked = calls.waiting.remove(&call);
        drop(calls);
        if let Some(asked) = asked {
            let until = Instant::now() + MATCHING;
            self.answers.push(Answer { asked, data, until });
        }
    }

    /// Sends the replies whose callers read them by now: a caller's first request may be here before its reader is known.
    pub(crate) fn answer(&mut self) {
        self.replies.values_mut().for_each(Replies::look);
        let now = Instant::now();
        for answer in std::mem::take(&mut self.answers) {
            let Some(replies) = self.replies.get(&answer.asked.service) else {
                continue;
            };
            if now < answer.until && !replies.reach(answer.asked.from) {
                self.answers.push(answer);
                continue;
            }
            let Asked {
                service, caller, ..
            } = answer.asked;
            let (bytes, options) = caller.reply(answer.data);
            if let Err(error) = replies.writer.write_with_options(bytes, options) {
                eprintln!("mcdpr-ros: a reply of service {service} is lost: {error:?}");
            }
        }
    }

    /// Announces to other participants which node has these topics.
    fn announce(&self) {
        if self.entities.name.is_empty() {
            return;
        }
        let message = self.entities.encoded(self.participant.guid());
        if let Err(error) = self.info.write(message, None) {
            eprintln!("mcdpr-ros: the node's name is not known to others: {error:?}");
        }
    }
}

fn write_to(
    participant: &DomainParticipant,
    publisher: &Publisher,
    (topic, kind): (&str, &str),
    qos: QosPolicies,
) -> Result<DataWriter<Raw, AsIs>, NodeError> {
    let made = participant.create_topic(topic.to_owned(), kind.to_owned(), &qos, TopicKind::NoKey);
    let made = made.map_err(dds(topic))?;
    let writer = publisher.create_datawriter_no_key::<Raw, AsIs>(&made, Some(qos));
    writer.map_err(dds(topic))
}

/// Passes the calls of a service on, until standard output is closed.
fn listen(service: u32, reader: DataReader<Raw, AsIs>, calls: &Mutex<Calls>) {
    let mut requests = reader.async_sample_stream();
    while let Some(request) = futures::executor::block_on(requests.next()) {
        let request = match request {
            Ok(request) => request,
            Err(error) => {
                eprintln!("mcdpr-ros: a call of service {service} cannot be read: {error}");
                continue;
            }
        };
        let info = request.sample_info().clone();
        let Some((caller, data)) = received(&info, request.into_value()) else {
            eprintln!("mcdpr-ros: a call of service {service} is too short");
            continue;
        };
        let mut known = calls.lock().unwrap_or_else(PoisonError::into_inner);
        let from = info.writer_guid();
        let call = known.add(Asked {
            service,
            caller,
            from,
        });
        drop(known);
        let data = Hex(data);
        let said = Said::Call {
            service,
            call,
            data,
        };
        let Ok(line) = serde_json::to_string(&said) else {
            continue;
        };
        let mut out = std::io::stdout().lock();
        if writeln!(out, "{line}").and_then(|()| out.flush()).is_err() {
            return;
        }
    }
}
