//! Telemetry that the board sends without a request: samples of every tick, and its state.

use crate::frame::{Channel, FrameError, MAX_FRAME, encode_frame};
use crate::{
    ConfigHash, FaultRecord, Limits, List, Milliamps, Millinewtons, PerCable, TenthMicrometres,
    Tick,
};
use postcard::experimental::max_size::MaxSize;
use serde::{Deserialize, Serialize};

/// States of the supervisor. Append only.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, MaxSize)]
pub enum BoardState {
    /// Starting; everything is off.
    #[default]
    Boot,
    /// Brakes closed, torque off.
    Disarmed,
    /// Enabling drives and checking.
    Arming,
    /// At rest under tension.
    Holding,
    /// Following the buffered motion.
    Moving,
    /// Decelerating along the path to hold.
    Pausing,
    /// Decelerating along the path, then brakes, then torque off.
    Stopping,
    /// A fault is latched; brakes closed, torque off.
    Fault,
    /// The emergency stop is pressed.
    EStop,
}

/// Counters and state, sent ten times a second and at every change of state.
#[derive(Debug, Default, Clone, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct Status {
    /// Its tick.
    pub tick: Tick,
    /// The board's state.
    pub state: BoardState,
    /// Path time of the motion in progress, ms.
    pub path_ms: u32,
    /// Commanded length of each cable; where the next motion must start.
    pub setpoints: PerCable<TenthMicrometres>,
    /// Measured length of each cable.
    pub lengths: PerCable<TenthMicrometres>,
    /// Measured tension of each cable.
    pub tensions: PerCable<Millinewtons>,
    /// Free knots of the motion buffer.
    pub knots_free: u8,
    /// The number that the next knot must have.
    pub next_knot: u16,
    /// First fault since the last clear.
    pub fault: Option<FaultRecord>,
    /// Values near their limits.
    pub limits: Limits,
    /// The active configuration.
    pub config: Option<ConfigHash>,
    /// Whether the lengths are referenced.
    pub referenced: bool,
    /// Bit set of open brakes.
    pub brakes_open: u8,
    /// Bit set of drives that give torque.
    pub torque_on: u8,
    /// Whether the gripper is commanded closed.
    pub gripper_closed: bool,
    /// Whether the gripper's switch is closed.
    pub gripper_switch: bool,
    /// Frames received intact.
    pub frames_ok: u32,
    /// Damaged frames: checksum, length, form.
    pub frames_bad: u32,
    /// Requests out of order or repeated.
    pub sequence_errors: u32,
    /// Ticks that started late.
    pub tick_overruns: u32,
    /// Telemetry frames dropped because the link was full.
    pub telemetry_dropped: u32,
}

impl Status {
    /// Measured length of each cable, m.
    pub fn lengths_m(&self) -> impl Iterator<Item = f64> {
        self.lengths.iter().map(|length| length.metres())
    }

    /// Commanded length of each cable, m.
    pub fn setpoints_m(&self) -> impl Iterator<Item = f64> {
        self.setpoints.iter().map(|length| length.metres())
    }

    /// Measured tension of each cable, N.
    pub fn tensions_n(&self) -> impl Iterator<Item = f64> {
        self.tensions.iter().map(|tension| tension.newtons())
    }
}

/// Bytes of packed samples in one block.
// Four cables: 4 x 4 bytes per tick and 4 x 2 per two ticks, 200 in 10 ticks.
pub const SAMPLE_BYTES: usize = 200;

/// Samples of consecutive ticks.
///
/// Packed per tick and cable, cable 1 first, little-endian: change of length since the tick
/// before (i16, 0.1 µm), tension (u16: below 32,768 mN; from there on 32,768 + 16 mN for each more, up to
/// 557 N); after the cables of every tick with an even position
/// in the block, the motor currents (i16, mA), which change no faster than the drive bus.
#[derive(Debug, Default, Clone, PartialEq, Eq, Serialize, Deserialize, MaxSize)]
pub struct SampleBlock {
    /// Tick of the first sample.
    pub tick: Tick,
    /// Path time of the first sample, ms.
    pub path_ms: u32,
    /// Length of each cable one tick before the first sample.
    pub lengths: PerCable<TenthMicrometres>,
    /// The packed samples.
    pub packed: List<u8, SAMPLE_BYTES>,
}

/// One tick of one cable, unpacked.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct Sample {
    /// Paid-out length by the drum encoder.
    pub length: TenthMicrometres,
    /// Tension at the winch.
    pub tension: Millinewtons,
    /// Motor current; of odd ticks, that of the tick before.
    pub current: Milliamps,
}

/// From here on a sample's tension has steps of 16 mN, mN: they are below the noise of the sensors that reach so far.
const COARSE_FROM: i32 = 0x8000;
/// log2 of these steps.
const COARSE_SHIFT: u32 = 4;
/// The coarse steps go on where the fine ones end.
const COARSE_OFFSET: i32 = COARSE_FROM - (COARSE_FROM >> COARSE_SHIFT);

/// A tension in a sample: more than 557 N saturates, a negative reading is 0.
#[expect(clippy::cast_sign_loss, reason = "0 at least")]
fn coarse(Millinewtons(tension): Millinewtons) -> u16 {
    let packed = if tension >= COARSE_FROM {
        COARSE_OFFSET + (tension >> COARSE_SHIFT)
    } else {
        tension
    };
    packed.clamp(0, 0xFFFF) as u16
}

fn fine(packed: u16) -> Millinewtons {
    let packed = i32::from(packed);
    Millinewtons(if packed >= COARSE_FROM {
        (packed - COARSE_OFFSET) << COARSE_SHIFT
    } else {
        packed
    })
}

impl SampleBlock {
    /// Ticks that one block carries for a board with this many cables.
    ///
    /// ```
    /// use mcdpr_protocol::SampleBlock;
    /// assert_eq!(SampleBlock::ticks(4), 10);
    /// assert_eq!(SampleBlock::ticks(8), 4);
    /// ```
    #[must_use]
    pub const fn ticks(cables: usize) -> usize {
        match cables {
            // Even numbers where they fit: currents come with every second tick. Eight cables: 8 x
            // 10 bytes in two ticks, 160 in 4.
            0..=4 => 10,
            5 => 8,
            6 => 6,
            7 => 5,
            _ => 4,
        }
    }

    /// Appends one tick; `samples` holds one entry per cable, `previous` their lengths a tick ago.
    ///
    /// A change of length over 3.2 mm in a tick saturates; the next block starts from absolute
    /// lengths again. Returns `false` if the block has no room.
    pub fn append(
        &mut self,
        position: usize,
        previous: &[TenthMicrometres],
        samples: &[Sample],
    ) -> bool {
        for (sample, before) in samples.iter().zip(previous) {
            // 3.2 mm per ms are 3.2 m/s, above every winch of this project.
            let change = sample.length.0.saturating_sub(before.0);
            let change =
                i16::try_from(change).unwrap_or(if change < 0 { i16::MIN } else { i16::MAX });
            let tension = coarse(sample.tension);
            if !self.put(change.to_le_bytes()) || !self.put(tension.to_le_bytes()) {
                return false;
            }
        }
        // Every second tick: drives answer every 2 ms.
        position % 2 == 1
            || samples.iter().all(|sample| {
                let current = sample.current.0;
                let clamped =
                    i16::try_from(current).unwrap_or(if current < 0 { i16::MIN } else { i16::MAX });
                self.put(clamped.to_le_bytes())
            })
    }

    fn put(&mut self, bytes: [u8; 2]) -> bool {
        bytes.into_iter().all(|byte| self.packed.push(byte).is_ok())
    }

    /// Encodes the block into a frame, as [`encode_answer`](crate::message::encode_answer) does an
    /// answer.
    ///
    /// # Errors
    /// Never: every block fits.
    pub fn encode(&self, out: &mut [u8; MAX_FRAME]) -> Result<usize, FrameError> {
        encode_frame(Channel::Samples, self, out)
    }

    /// Unpacks: calls `each` with the tick and one sample per cable, in time order.
    ///
    /// Stops at the first incomplete tick of a damaged block.
    pub fn unpack(&self, mut each: impl FnMut(Tick, &[Sample])) {
        let cables = self.lengths.len();
        let mut row = PerCable::<Sample>::collect(self.lengths.iter().map(|&length| Sample {
            length,
            ..Sample::default()
        }));
        let mut words = self
            .packed
            .chunks_exact(2)
            .filter_map(|pair| pair.first_chunk::<2>());
        for position in 0.. {
            if cables == 0 {
                return;
            }
            for sample in row.iter_mut() {
                let (Some(change), Some(tension)) = (words.next(), words.next()) else {
                    return;
                };
                sample.length.0 = sample
                    .length
                    .0
                    .saturating_add(i32::from(i16::from_le_bytes(*change)));
                sample.tension = fine(u16::from_le_bytes(*tension));
            }
            if position % 2 == 0 {
                for sample in row.iter_mut() {
                    // An incomplete block ends here: samples of the ticks before are valid.
                    let Some(current) = words.next() else { return };
                    sample.current.0 = i32::from(i16::from_le_bytes(*current));
                }
            }
            each(self.tick.after(position), &row);
        }
    }
}
