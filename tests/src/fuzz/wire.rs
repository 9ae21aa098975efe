//! Bytes that reach a board: framing, decoding, dispatch.

use super::bench::Bench;
use mcdpr_firmware::server::{Incoming, LinkCounters, Receiver};
use mcdpr_firmware::{Brake, DriveDemand, supervisor};
use mcdpr_protocol::frame::{MAX_BODY, MAX_FRAME, encode_bytes};
use mcdpr_protocol::message::decode;
use mcdpr_protocol::{
    Answer, Channel, Command, Deframer, FaultRecord, Hello, Request, SampleBlock, Status,
    encode_frame,
};
use std::sync::OnceLock;

/// Any bytes, as one stream: what comes out was framed, nothing is longer than a frame, and
/// whatever came before, a whole frame after a delimiter is taken.
pub fn deframer(bytes: &[u8]) {
    let mut deframer = Deframer::new();
    let mut out = [0; MAX_FRAME];
    for &byte in bytes {
        if let Some(Ok((channel, body))) = deframer.push(byte) {
            assert!(byte == 0 && body.len() <= MAX_BODY);
            let body = body.to_vec();
            assert!(encode_bytes(channel, &body, &mut out).is_ok());
        }
    }
    let _ = deframer.push(0);
    let used = encode_bytes(Channel::Command, b"after it", &mut out).unwrap_or(0);
    let frame = out.get(..used).unwrap_or_default();
    let taken = frame
        .iter()
        .fold(None, |_, &byte| match deframer.push(byte) {
            Some(Ok((channel, body))) => Some((channel, body.to_vec())),
            _ => None,
        });
    assert_eq!(taken, Some((Channel::Command, b"after it".to_vec())));
}

/// Any body, as each of the messages: what is taken is a message that can be sent again.
pub fn decoder(body: &[u8]) {
    let mut out = [0; MAX_FRAME];
    if let Some(command) = decode::<Command>(body) {
        assert!(encode_frame(Channel::Command, &command, &mut out).is_ok());
    }
    if let Some(answer) = decode::<Answer>(body) {
        assert!(encode_frame(Channel::Answer, &answer, &mut out).is_ok());
    }
    if let Some(status) = decode::<Status>(body) {
        assert!(encode_frame(Channel::Status, &status, &mut out).is_ok());
    }
    let _ = Hello::from_bytes(body);
    if let Some(block) = decode::<SampleBlock>(body) {
        block.unpack(|_, row| assert_eq!(row.len(), block.lengths.len()));
    }
}

/// Boards to begin with: just started, configured and referenced, holding, moving.
fn boards() -> &'static [Bench; 4] {
    static BOARDS: OnceLock<[Bench; 4]> = OnceLock::new();
    BOARDS.get_or_init(|| {
        let mut new = Bench::new();
        new.step();
        [
            new,
            Bench::ready(),
            Bench::holding(),
            Bench::moving(2000, 100),
        ]
    })
}

/// A board that is watched: every rule is checked at every request and every tick.
struct Watched {
    bench: Bench,
    receiver: Receiver,
    record: Option<FaultRecord>,
    cleared: bool,
    /// It was armed, or was asked to, since it was last seen disarmed.
    may_arm: bool,
    ticks: u32,
}

impl Watched {
    fn new(which: u8) -> Self {
        let boards = boards();
        let bench = boards.get(usize::from(which) % boards.len());
        let bench = bench.unwrap_or(&boards[0]).clone();
        Self {
            may_arm: bench.server.controller().is_armed(),
            bench,
            receiver: Receiver::default(),
            record: None,
            cleared: false,
            ticks: 0,
        }
    }

    fn byte(&mut self, byte: u8) {
        if let Some(Incoming::Command(command)) = self.receiver.push(byte) {
            self.command(&command);
        }
    }

    fn command(&mut self, command: &Command) {
        let asks_to_arm = matches!(
            command.request,
            Request::Arm { .. } | Request::Service { .. }
        );
        let counters = LinkCounters::default();
        let answer = self
            .bench
            .server
            .receive(self.bench.now, command, &counters);
        self.cleared |= command.request == Request::ClearFault;
        self.may_arm |= asks_to_arm && answer.result.is_ok();
        let mut out = [0; MAX_FRAME];
        assert!(encode_frame(Channel::Answer, &answer, &mut out).is_ok());
        self.check();
    }

    fn step(&mut self) {
        let before = self.bench.now;
        self.bench.step();
        self.ticks += 1;
        let controller = self.bench.server.controller();
        // No tick is missed, whatever arrives.
        assert_eq!(controller.now(), before.after(1));
        assert_eq!(controller.status().tick_overruns, 0);
        let outputs = self.bench.outputs;
        let slots = outputs.drives.iter().zip(&outputs.brakes);
        for (demand, brake) in slots {
            assert!(
                *brake == Brake::Closed || demand.gives_torque(),
                "{outputs:?}"
            );
            assert!(controller.is_armed() || *demand == DriveDemand::Off);
        }
        self.check();
    }

    fn check(&mut self) {
        let controller = self.bench.server.controller();
        let state = controller.state();
        let armed = controller.is_armed();
        assert_eq!(armed, supervisor::may_give_torque(state));
        assert!(
            !armed || controller.config().is_some(),
            "armed, not configured"
        );
        assert!(!armed || self.may_arm, "armed by nobody");
        self.may_arm = armed;
        let record = controller.fault();
        assert!(
            record.is_none() || state != mcdpr_firmware::State::Moving,
            "moving with {record:?}"
        );
        if let Some(first) = self.record {
            assert!(
                self.cleared || record == Some(first),
                "{first:?}, {record:?}"
            );
        }
        self.cleared = false;
        self.record = record;
    }
}

/// Bytes of the line that take a millisecond at 921600 baud.
const BYTES_PER_TICK: usize = 92;

/// Any bytes on a board's line; the first says which board. Gives the ticks that were run.
pub fn dispatcher_stream(bytes: &[u8]) -> u32 {
    let Some((&which, bytes)) = bytes.split_first() else {
        return 0;
    };
    let mut board = Watched::new(which);
    for chunk in bytes.chunks(BYTES_PER_TICK) {
        chunk.iter().for_each(|&byte| board.byte(byte));
        board.step();
    }
    board.ticks
}

/// Requests in frames with a valid checksum: the first byte says which board, then each piece
/// begins with its length and with how it is sent. Gives the requests that were understood.
pub fn dispatcher_requests(bytes: &[u8]) -> u32 {
    let Some((&which, mut rest)) = bytes.split_first() else {
        return 0;
    };
    let mut board = Watched::new(which);
    let mut understood = 0;
    while let [length, how, tail @ ..] = rest {
        let (body, tail) = tail.split_at(usize::from(*length).min(tail.len()));
        rest = tail;
        // Three of four are a request of the session that holds the board, with the right number.
        if how % 4 != 0 {
            if let Some(request) = decode::<Request>(body) {
                understood += 1;
                let sequenced = request.is_sequenced() || request == Request::Open;
                let command = Command {
                    session: board.bench.session,
                    sequence: board.bench.next,
                    request,
                };
                send(&mut board, &command);
                if sequenced {
                    board.bench.next = board.bench.next.next();
                }
            }
        } else {
            let mut out = [0; MAX_FRAME];
            let body = body.get(..body.len().min(MAX_BODY)).unwrap_or_default();
            let used = encode_bytes(Channel::Command, body, &mut out).unwrap_or(0);
            let frame = out.get(..used).unwrap_or_default();
            frame.iter().for_each(|&byte| board.byte(byte));
        }
        for _ in 0..(how / 4 % 8) {
            board.step();
        }
        // Now and then much time goes by: a stop, an arming.
        if how / 32 == 7 {
            (0..400).for_each(|_| board.step());
        }
    }
    understood
}

fn send(board: &mut Watched, command: &Command) {
    let mut out = [0; MAX_FRAME];
    let used = encode_frame(Channel::Command, command, &mut out).unwrap_or(0);
    let frame = out.get(..used).unwrap_or_default();
    frame.iter().for_each(|&byte| board.byte(byte));
}

/// The request that arms the boards of [`dispatcher_requests`].
#[must_use]
pub fn arm() -> Request {
    Bench::arm_request()
}

/// The request that sets their lengths.
#[must_use]
pub fn reference() -> Request {
    Bench::reference_request()
}

/// A request's bytes, as the body of [`dispatcher_requests`].
#[must_use]
pub fn body(request: &Request) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let used = encode_frame(Channel::Command, request, &mut out).unwrap_or(0);
    let mut deframer = Deframer::new();
    let frame = out.get(..used).unwrap_or_default();
    let mut bodies = frame.iter().filter_map(|&byte| match deframer.push(byte) {
        Some(Ok((_, body))) => Some(body.to_vec()),
        _ => None,
    });
    bodies.next().unwrap_or_default()
}
