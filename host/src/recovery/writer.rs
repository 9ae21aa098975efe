//! Keeps the journal while a robot moves, on a thread of its own.
//!
//! An [`EventBus`](crate::record::EventBus) passes the frames of the line to the writer, through a queue
//! for which the line never waits. A disk that stalls loses the newest states and delays no heartbeat.

use super::disk::{Disk, now_ms};
use super::{Identity, Plan};
use crate::record::decode::{Decoder, Seen, Tick};
use crate::record::events::{RunEvent, Watcher};
use crate::run::saved::board_name;
use mcdpr_core::recovery::journal::{Encoder, Kept, KeptCable, Mark};
use mcdpr_protocol::{BoardState, Status};

/// Time between states, µs.
const EVERY_US: u64 = 9_000;
/// Time between flushes to the disk, µs.
const FLUSH_US: u64 = 50_000;
/// Bytes after which a file is begun anew.
const ANEW_BYTES: usize = 512 << 10;

/// The run that a journal belongs to.
#[derive(Debug, Clone, PartialEq)]
pub struct About {
    /// Number of the session on the wire.
    pub session: u32,
    /// Name of the robot.
    pub robot: String,
    /// Checksum of its geometry and scale.
    pub scale: u32,
    /// Name of the task, or its file.
    pub task: String,
    /// Checksum of the task's text, or of its name.
    pub task_hash: u32,
}

/// Writes a journal. It begins when the brakes open: a run that is refused before leaves the journal
/// of the one before as it is.
pub(crate) struct JournalWriter<O, D> {
    about: About,
    /// Gives the place for a board's journal.
    open: O,
    disk: Option<D>,
    decoder: Decoder,
    encoder: Encoder,
    board: Option<String>,
    plan: Option<Plan>,
    kept: Option<Kept>,
    written_us: Option<u64>,
    flushed_us: u64,
    bytes: usize,
    /// Records since the last flush. A record is safe only after the flush, so that a write for each
    /// would cost five times as many calls of the system and keep nothing longer.
    waiting: Vec<u8>,
    /// Whether a write has failed; then nothing more is written.
    failed: bool,
    /// Whether the board has started again; then only the end is still to be written.
    over: bool,
}

impl<O, D> JournalWriter<O, D>
where
    O: FnMut(&str) -> std::io::Result<D> + Send + 'static,
    D: Disk,
{
    /// A writer whose place is given by `open` when the board is known.
    #[must_use]
    pub fn new(about: About, open: O) -> Self {
        Self {
            about,
            open,
            disk: None,
            decoder: Decoder::default(),
            encoder: Encoder::default(),
            board: None,
            plan: None,
            kept: None,
            written_us: None,
            flushed_us: 0,
            bytes: 0,
            waiting: Vec::new(),
            failed: false,
            over: false,
        }
    }

    fn take_status(&mut self, time_us: u64, status: &Status) {
        // A board that no longer knows its lengths has started again: what it says now is not where
        // the robot was.
        let knew = self.kept.as_ref().is_some_and(|kept| kept.referenced);
        self.over |= knew && !status.referenced && self.disk.is_some();
        if self.over {
            return;
        }
        let before = self.kept.take().unwrap_or_default();
        let rows = status.lengths.iter().zip(status.setpoints.iter());
        let rows = rows.zip(status.tensions.iter()).enumerate();
        let cables = rows.map(|(index, ((length, setpoint), tension))| KeptCable {
            length_m: length.metres(),
            setpoint_m: setpoint.metres(),
            speed_mps: before
                .cables
                .get(index)
                .map_or(0.0, |cable| cable.speed_mps),
            tension_n: tension.newtons(),
        });
        let mut kept = Kept {
            time_us,
            path_ms: status.path_ms,
            state: status.state,
            referenced: status.referenced,
            brakes_open: status.brakes_open,
            torque_on: status.torque_on,
            gripper_closed: status.gripper_closed,
            gripper_switch: status.gripper_switch,
            cables: cables.collect(),
        };
        // At rest by its state: a speed from the block before is over.
        if matches!(status.state, BoardState::Holding | BoardState::Disarmed) {
            for cable in &mut kept.cables {
                cable.speed_mps = 0.0;
            }
        }
        self.kept = Some(kept);
        self.write(time_us);
    }

    fn take_ticks(&mut self, time_us: u64, ticks: &[Tick]) {
        let (Some(kept), Some(first), Some(last)) = (&mut self.kept, ticks.first(), ticks.last())
        else {
            return;
        };
        kept.time_us = time_us;
        kept.path_ms = milliseconds(last.path_s.unwrap_or(0.0));
        let over_s = f64::from(last.tick.wrapping_sub(first.tick)) * 1e-3;
        for (index, cable) in kept.cables.iter_mut().enumerate() {
            let at = |list: &[f64]| list.get(index).copied();
            let (Some(from_m), Some(to_m)) = (at(&first.lengths_m), at(&last.lengths_m)) else {
                continue;
            };
            let planned = last.planned.get(index).filter(|_| kept.path_ms > 0);
            cable.length_m = to_m;
            cable.speed_mps = match planned {
                // A drum's counts are coarse: over a block they jump by more than a slow drum moves.
                Some(planned) => planned.speed_mps,
                None if kept.state == BoardState::Holding => 0.0,
                None if over_s > 0.0 => (to_m - from_m) / over_s,
                None => 0.0,
            };
            if let Some(planned) = planned {
                cable.setpoint_m = planned.length_m;
            }
            if let Some(tension_n) = at(&last.tensions_n) {
                cable.tension_n = tension_n;
            }
        }
        // Blocks of up to 4 cables come every 10 ms and are all kept; of faster ones, some.
        if self
            .written_us
            .is_none_or(|written| time_us >= written + EVERY_US)
        {
            self.write(time_us);
        }
    }

    /// Writes the present state, and begins a new file where that is due.
    fn write(&mut self, time_us: u64) {
        if self.failed || self.over {
            return;
        }
        if let Err(error) = self.try_write(time_us) {
            self.failed = true;
            eprintln!("warning: the journal ends here, after a loss of power home again: {error}");
        }
    }

    fn try_write(&mut self, time_us: u64) -> std::io::Result<()> {
        let (Some(kept), Some(board)) = (&self.kept, &self.board) else {
            return Ok(());
        };
        let begun = self.disk.is_some();
        // Before the brakes open nothing can have moved: the journal of the run before stays valid.
        if !begun && kept.brakes_open == 0 && kept.state != BoardState::Arming {
            return Ok(());
        }
        if !begun || self.bytes > ANEW_BYTES {
            let identity = Identity {
                board: board.clone(),
                session: self.about.session,
                robot: self.about.robot.clone(),
                scale: self.about.scale,
                task: self.about.task.clone(),
                task_hash: self.about.task_hash,
                wall_ms: now_ms(),
            };
            let mut bytes = self.encoder.begin(&identity, self.plan.as_ref());
            bytes.extend(self.encoder.kept(kept));
            self.bytes = bytes.len();
            let disk = match &mut self.disk {
                Some(disk) => disk,
                none => none.insert((self.open)(board)?),
            };
            // The file before keeps its last states: it is what is left if the new one never begins.
            if !self.waiting.is_empty() {
                disk.append(&self.waiting)?;
                self.waiting.clear();
            }
            disk.begin(&bytes)?;
            self.written_us = Some(time_us);
            return self.flush(time_us);
        }
        let record = self.encoder.kept(kept);
        self.append(&record);
        self.written_us = Some(time_us);
        if time_us >= self.flushed_us + FLUSH_US {
            self.flush(time_us)?;
        }
        Ok(())
    }

    /// A record for the next flush.
    fn append(&mut self, record: &[u8]) {
        self.waiting.extend_from_slice(record);
        self.bytes += record.len();
    }

    fn write_waiting(&mut self) -> std::io::Result<()> {
        if let Some(disk) = &mut self.disk
            && !self.waiting.is_empty()
        {
            disk.append(&self.waiting)?;
        }
        self.waiting.clear();
        Ok(())
    }

    fn flush(&mut self, time_us: u64) -> std::io::Result<()> {
        self.flushed_us = time_us;
        self.write_waiting()?;
        let mark = Mark {
            session: self.about.session,
            number: self.encoder.number(),
        };
        match &mut self.disk {
            Some(disk) => disk.sync(mark),
            None => Ok(()),
        }
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a motion lasts minutes"
)]
fn milliseconds(seconds: f64) -> u32 {
    (seconds * 1e3).round() as u32
}

impl<O, D> Watcher for JournalWriter<O, D>
where
    O: FnMut(&str) -> std::io::Result<D> + Send + 'static,
    D: Disk,
{
    fn see(&mut self, event: &RunEvent) {
        match event {
            RunEvent::Wire { frame, .. } => {
                for seen in self.decoder.take(frame) {
                    match seen {
                        Seen::Hello(hello) => self.board = Some(board_name(&hello)),
                        Seen::Status(status) => self.take_status(frame.time_us, &status),
                        Seen::Ticks(ticks) => self.take_ticks(frame.time_us, &ticks),
                        Seen::Beat { state, .. } => {
                            if let Some(kept) = &mut self.kept {
                                kept.state = state;
                            }
                        }
                        Seen::Asked(_) | Seen::Knot(_) | Seen::Refused(_) => {}
                    }
                }
            }
            RunEvent::Plan { plan, .. } => {
                let Some(first) = plan.points.first() else {
                    return;
                };
                let resumed = plan.resumed.clone();
                let plan = Plan {
                    start_m: resumed.as_ref().map_or(first.tool_m, |of| of.start_m),
                    duration_s: plan.duration_s,
                    interruptions: resumed.map_or_else(Vec::new, |of| of.interruptions),
                };
                if self.disk.is_some() {
                    let record = self.encoder.plan(&plan);
                    self.append(&record);
                }
                self.plan = Some(plan);
            }
            _ => {}
        }
    }

    fn end(&mut self) {
        if self.failed || self.disk.is_none() {
            return;
        }
        let record = self.encoder.end();
        let time_us = self.flushed_us;
        self.append(&record);
        if let Err(error) = self.flush(time_us) {
            eprintln!("warning: the journal's end was not kept: {error}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Journal, MemoryDisk};
    use super::*;
    use crate::link::{Direction, RawFrame};
    use crate::record::EventBus;
    use crate::record::events::Patience;
    use mcdpr_twin::Sink as _;
    use std::sync::atomic::Ordering;
    use std::sync::mpsc::{Receiver, Sender, channel};

    fn about() -> About {
        About {
            session: 3,
            robot: "r".to_owned(),
            scale: 1,
            task: "t".to_owned(),
            task_hash: 2,
        }
    }

    fn wire(time_us: u64) -> RunEvent {
        RunEvent::Wire {
            call: 0,
            frame: RawFrame {
                time_us,
                direction: Direction::ToHost,
                bytes: vec![0; 40],
            },
        }
    }

    /// A disk that stalls until the test releases it.
    struct Stalled {
        began: Sender<()>,
        go_on: Receiver<()>,
    }

    impl Disk for Stalled {
        fn begin(&mut self, _: &[u8]) -> std::io::Result<()> {
            let _ = self.began.send(());
            let _ = self.go_on.recv();
            Ok(())
        }
        fn append(&mut self, _: &[u8]) -> std::io::Result<()> {
            Ok(())
        }
        fn sync(&mut self, _: Mark) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_stalled_disk_delays_no_line() {
        let (began, has_begun) = channel();
        let (release, go_on) = channel();
        let mut parts = Some((began, go_on));
        let mut writer = JournalWriter::new(about(), move |_: &str| {
            let (began, go_on) = parts.take().unwrap();
            Ok(Stalled { began, go_on })
        });
        writer.board = Some("00".to_owned());
        writer.kept = Some(Kept {
            state: BoardState::Arming,
            ..Kept::default()
        });
        let mut bytes = [0; mcdpr_protocol::frame::MAX_FRAME];
        let arming = Status {
            state: BoardState::Arming,
            ..Status::default()
        };
        let used = mcdpr_protocol::message::encode_status(&arming, &mut bytes).unwrap();
        let status = bytes[..used].to_vec();
        let mut events = EventBus::default();
        let lost = events.add(writer, Patience::Drop).unwrap();
        let mut first = wire(0);
        if let RunEvent::Wire { frame, .. } = &mut first {
            frame.bytes = status;
        }
        events.publish(first);
        has_begun.recv().unwrap();
        // More than five seconds of a busy line while the disk stalls: every call returns, and
        // frames without room in the queue are counted.
        for index in 0..25_000_u64 {
            events.publish(wire(index * 1000));
        }
        assert!(lost.load(Ordering::Relaxed) > 4000);
        release.send(()).unwrap();
        events.finish();
    }

    #[test]
    fn a_run_that_never_opens_a_brake_leaves_the_journal_before_alone() {
        let disk = MemoryDisk::default();
        let mine = disk.clone();
        let mut writer = JournalWriter::new(about(), move |_: &str| Ok(mine.clone()));
        writer.board = Some("00".to_owned());
        writer.take_status(1000, &Status::default());
        writer.end();
        assert!(disk.bytes().is_empty());
        let status = Status {
            state: BoardState::Holding,
            brakes_open: 15,
            ..Status::default()
        };
        writer.take_status(20_000, &status);
        let journal = Journal::read(&disk.bytes()).unwrap();
        assert_eq!(journal.last.unwrap().brakes_open, 15);
        assert!(!journal.ended);
        writer.end();
        assert!(Journal::read(&disk.bytes()).unwrap().ended);
    }

    #[test]
    fn a_board_that_has_started_again_does_not_overwrite_where_it_was() {
        let disk = MemoryDisk::default();
        let mine = disk.clone();
        let mut writer = JournalWriter::new(about(), move |_: &str| Ok(mine.clone()));
        writer.board = Some("00".to_owned());
        let holding = Status {
            state: BoardState::Holding,
            brakes_open: 15,
            referenced: true,
            ..Status::default()
        };
        writer.take_status(1000, &holding);
        writer.take_status(900_000, &Status::default());
        writer.take_status(950_000, &holding);
        writer.end();
        let journal = Journal::read(&disk.bytes()).unwrap();
        let last = journal.last.unwrap();
        assert!(last.referenced && journal.ended);
        assert_eq!(last.time_us, 1000);
    }
}
