//! Arming: enable drives under closed brakes, check the sensors, push against the brakes, open
//! them, then turn each drum slightly out and in.

use crate::adc;
use crate::axis::Target;
use crate::config::{Active, CableConfig, Control};
use crate::io::{DriveInput, Inputs};
use crate::proof;
use crate::tension;
use crate::watch::{Finding, Persist};
use mcdpr_protocol::FaultId;

/// Milliseconds that drives may take beyond their own enable time (D5).
const ENABLE_GRACE_MS: u32 = 500;
/// Milliseconds of torque under closed brakes before they are tested.
// Longer than the current's rise (3 ms on the paper's robot) and several periods of the bus.
const PRELOAD_MS: u32 = 30;
/// Milliseconds for the test of the brakes, at most.
// Without play the push is reached after about 60 ms and held for 200 ms, and the load is carried
// again after as long (docs/safety.md). With play, `proof::play_ms` is added.
const PROOF_MS: u32 = 1500;
/// Milliseconds for the platform to come to rest after the drums were moved: some of its stiff
/// modes, near 10 Hz, decay within half a second.
const SETTLE_MS: u32 = 500;
/// Milliseconds that brakes are given to open.
// An assumption about the brakes: a brake that needs longer is found by the drums' motion (B1).
const OPEN_MS: u32 = 50;
/// The tension may differ from the static model by this, mN, or by a fifth of it (S10).
// 2 N up to 10 N. Example: at 15 N the band is a fifth, 3 N.
const TENSION_BAND_MN: i32 = 2000;
/// A cable below its floor for so many ticks after the first check aborts arming (C1).
// 5 ms: opening a brake on a cable that just broke must be prevented, a disturbed reading must not
// abort.
const SLACK_TICKS: u16 = 5;

/// Phase of arming.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Default)]
pub enum Phase {
    /// Drives enable; brakes closed.
    #[default]
    Enabling,
    /// Drives give torque against closed brakes.
    Preload,
    /// Drives push against closed brakes, which must hold (B2).
    Proving,
    /// Brakes open.
    Opening,
    /// Each drum in turn moves out and in slightly: brake, encoder and motor must agree (B1, S4).
    Oscillating(u8),
    /// All drums are free; waiting for rest.
    Settling,
    /// Done.
    Done,
}

impl Phase {
    /// Whether the brakes have had time to open: only the drives hold the drums.
    #[must_use]
    pub(crate) const fn is_free(self) -> bool {
        matches!(self, Self::Oscillating(_) | Self::Settling | Self::Done)
    }
}

/// Progress of arming.
#[derive(Debug, Clone, Copy, Default)]
pub struct Arming {
    phase: Phase,
    ticks: u32,
    /// Some cable is below its floor.
    slack: Persist,
}

/// Work on a single winch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Service {
    /// Its number, 1 for the first.
    pub cable: u8,
    /// Whether its brake opens.
    pub open: bool,
}

/// Whether a winch (1 for the first) is enabled.
#[must_use]
pub(crate) fn concerns(service: Option<Service>, cable: u8) -> bool {
    service.is_none_or(|service| service.cable == cable)
}

/// Why arming is aborted: fault, cable (1 for the first), value, limit.
pub type Abort = (FaultId, u8, i32, i32);

impl Arming {
    /// Its phase.
    #[must_use]
    pub const fn phase(&self) -> Phase {
        self.phase
    }

    /// One tick; `expected_mn` are the tensions of the static model, `proven` is whether all brakes
    /// hold.
    ///
    /// # Errors
    /// The check that failed.
    pub fn tick<const N: usize>(
        &mut self,
        config: &Active<N>,
        inputs: &Inputs<N>,
        expected_mn: &[i32; N],
        service: Option<Service>,
        unproven: u8,
    ) -> Result<Phase, Abort> {
        // Counts from the phase's beginning: every phase has its own timeout.
        self.ticks += 1;
        // Drives that are still coming up are judged by the phase's own time (D5).
        if self.phase != Phase::Enabling {
            check_drives(config, inputs, service)?;
            // A cable may break while drives and brakes are tested: no brake opens then. Once the
            // drums are free, the detectors of a robot under torque apply.
            if !self.phase.is_free() && service.is_none() {
                let slack = check_floors(config, inputs, expected_mn);
                if self.slack.update(slack.is_err(), SLACK_TICKS) {
                    slack?;
                }
            }
        }
        match self.phase {
            Phase::Enabling => {
                let pending = (1_u8..)
                    .zip(&inputs.drives)
                    .find(|(cable, d)| concerns(service, *cable) && !alive(config, d));
                let limit = config.enable_ms + ENABLE_GRACE_MS;
                match pending {
                    None => {
                        if service.is_none() {
                            // Floors first: a broken cable is to be reported as C1, not as a sensor
                            // that drifted (S10).
                            check_floors(config, inputs, expected_mn)?;
                            check_tensions(config, inputs, expected_mn)?;
                        }
                        // Only here: all drives are alive and all tensions plausible before any of
                        // them gives torque.
                        self.enter(Phase::Preload);
                    }
                    // It will not come up: waiting is useless. Value and limit are the drive's
                    // abort code and the object, its index above its sub-index.
                    Some((
                        cable,
                        &DriveInput {
                            refused: Some(refused),
                            ..
                        },
                    )) => {
                        let (code, object) = (refused.code, refused.object);
                        let words = (code.cast_signed(), object.cast_signed());
                        return Err((FaultId::D5, cable, words.0, words.1));
                    }
                    Some((cable, _)) if self.ticks >= limit => {
                        let ms = |ticks: u32| i32::try_from(ticks).unwrap_or(i32::MAX);
                        let (most, found) = (config.feedback_timeout_ms, (FaultId::D5, cable));
                        let (fault, cable) = name_silence(most, inputs, service.is_some(), found);
                        return Err((fault, cable, ms(self.ticks), ms(limit)));
                    }
                    Some(_) => {}
                }
            }
            // The closed brake itself is being tested: the host ends the test.
            Phase::Preload if service.is_some_and(|service| !service.open) => {}
            // No load hangs on a bare winch: there is nothing for its brake to prove.
            Phase::Preload if self.ticks >= PRELOAD_MS => {
                self.enter(if service.is_some() {
                    Phase::Opening
                } else {
                    Phase::Proving
                });
            }
            // Every brake has held more than its load: only now may one of them open.
            Phase::Proving if unproven == 0 => self.enter(Phase::Opening),
            // Here no drum moves and no drive pushes: the drive does not follow commands.
            Phase::Proving if self.ticks >= PROOF_MS + u32::from(proof::play_ms(config)) => {
                return Err((FaultId::D7, unproven, 0, 0));
            }
            Phase::Opening if self.ticks >= OPEN_MS => {
                self.enter(if service.is_some() {
                    Phase::Settling
                } else {
                    Phase::Oscillating(0)
                });
            }
            // One drum after the other: two that move together would change each other's tension.
            Phase::Oscillating(cable)
                if self.ticks >= oscillation_ticks(config, expected_mn, cable) =>
            {
                let next = cable + 1;
                let more = usize::from(next) < N;
                self.enter(if more {
                    Phase::Oscillating(next)
                } else {
                    Phase::Settling
                });
            }
            Phase::Settling if self.ticks >= SETTLE_MS => self.enter(Phase::Done),
            _ => {}
        }
        Ok(self.phase)
    }

    /// No further attempt: torque is on, and stays on.
    pub const fn end(&mut self) {
        self.phase = Phase::Done;
        self.ticks = 0;
    }

    fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.ticks = 0;
    }
}

/// A quarter of a lobe of the test motion, ticks.
const QUARTER: u32 = 10;
/// The same for a drum behind play, which moves further.
// On the paper's robot with 1 degree of play: 0.76 mm with a peak of 19 mm/s, and 16 N for 34 kg of drum and rotor.
const SLOW_QUARTER: u32 = 40;
/// Encoder counts by which a drum is moved.
// Two counts: the least that shows a direction beyond one count of quantisation. On the paper's
// drum (4096 counts, 20 mm) they are 61 um of cable.
const OSCILLATION_COUNTS: i64 = 2;
/// Greatest test motion, 0.1 µm, however coarse the encoder.
// 2 mm.
const OSCILLATION_MOST: i64 = 20_000;

/// Acceleration in each quarter, in halves of the largest.
const OSCILLATION_HALVES: [i32; 12] = [1, -1, -1, 1, -2, 2, 2, -2, 1, -1, -1, 1];

/// One drum's motion out, in and out again: half a lobe, a whole one, half a one. Area and first
/// moment are both zero, so that the platform, whose swing decays slowly, hardly swings.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Oscillation {
    ticks: u32,
    /// Displacement and speed now, 1/256 of 0.1 µm and of 0.1 µm/ms.
    at_q8: i32,
    speed_q8: i32,
    /// The length to return to, 0.1 µm.
    base: Option<i32>,
    /// Previous positions of motor and drum, 0.1 µm.
    from: Option<(i32, i32)>,
    /// Greatest motor displacement, and the drum's position at it, 0.1 µm.
    farthest: (i32, i32),
}

impl Oscillation {
    /// Test motion of a drum, 0.1 µm, for its encoder's resolution, and a quarter of a lobe of it, ticks. A cable whose
    /// set-point (mN) is under its floor is expected to be slack, one without a floor may be, or is not on its drum yet:
    /// then no load holds the gear on one flank, and the motor first turns through the play.
    #[must_use]
    // Once in the chip's memory, not in each of its callers.
    #[inline(never)]
    pub(crate) fn amplitude(config: &CableConfig, setpoint_mn: i32) -> (i32, u32) {
        let per_count_q24 = config.per_count_q24;
        let slack = config.floor_mn == 0 || setpoint_mn < config.floor_mn;
        // Twice: from half the motion out to all of it in, the drum then turns by a play at least, on whichever flank it
        // was.
        let play = if slack { 2 * config.play } else { 0 };
        let quarter = if play > 0 { SLOW_QUARTER } else { QUARTER };
        // At least 1.6 um: with a finer encoder the motion would vanish in the rounding below.
        let counts = (per_count_q24.abs() * OSCILLATION_COUNTS) >> 24;
        let amplitude = crate::fixed::saturate(counts.clamp(16, OSCILLATION_MOST)) + play;
        (amplitude, quarter)
    }

    /// The length around which the drum was moved, 0.1 µm.
    #[must_use]
    pub fn base(&self, length: i32) -> i32 {
        self.base.unwrap_or(length)
    }

    /// One tick: the drum's set-point. `length` is its target before the first.
    pub fn step(&mut self, (amplitude, quarter): (i32, u32), length: i32) -> Target {
        let base = *self.base.get_or_insert(length);
        let number = usize::try_from(self.ticks / quarter.max(1)).unwrap_or(usize::MAX);
        let halves = OSCILLATION_HALVES.get(number).copied().unwrap_or(0);
        // An acceleration a for a quarter and -a for the next end at rest at a * quarter^2: one
        // half gives half the amplitude, two halves all of it.
        let square = (quarter * quarter).max(1).cast_signed();
        let acceleration_q8 = halves * ((amplitude << 7) / square);
        // Exact integration over a tick of constant acceleration: the motion ends where it began.
        self.at_q8 += self.speed_q8 + acceleration_q8 / 2;
        self.speed_q8 += acceleration_q8;
        self.ticks += 1;
        // 0.1 µm/ms is 100 µm/s, 0.1 µm/ms² is 100 000 µm/s².
        // 100,000 / 256 is 390.6: 390 and a half, in 32 bits.
        let acceleration = (acceleration_q8 * 390).saturating_add(acceleration_q8 / 2);
        Target {
            length: base.saturating_add(self.at_q8 >> 8),
            speed_umps: (self.speed_q8 * 100) >> 8,
            acceleration_umps2: acceleration,
        }
    }

    /// Takes the positions of motor and drum, 0.1 µm.
    pub fn observe(&mut self, motor: i32, drum: i32) {
        let from = *self.from.get_or_insert((motor, drum));
        let gone = (motor.wrapping_sub(from.0), drum.wrapping_sub(from.1));
        // Motor and drum of the same tick: their greatest displacements alone could belong to
        // different moments.
        if gone.0.unsigned_abs() > self.farthest.0.unsigned_abs() {
            self.farthest = gone;
        }
    }

    /// The result of the whole motion; `by_speed` is whether the drive is commanded by speed.
    ///
    /// # Errors
    /// B1 if the motor could not turn, S4 if the drum turned the other way, S2 if it did not turn
    /// at all; with the measured and the expected displacement, µm.
    pub fn verdict(&self, amplitude: i32, by_speed: bool) -> Result<(), Finding> {
        let (motor, drum) = self.farthest;
        let along = if motor < 0 { -drum } else { drum };
        // A quarter, half an encoder count: less of the motor is not a motion, and less of the drum no
        // answer.
        let least = amplitude / 4;
        // The motor first: behind a motor that stands, the drum's stillness says nothing about its
        // encoder. Nor does it behind one that moved by less than an encoder count and a half, as a law that commands
        // a current does against stiff cables: such a drum is compared with its motor in motion.
        let (fault, moved) = if motor.abs() < least {
            (FaultId::B1, motor)
        } else if along < -least {
            (FaultId::S4, drum)
        } else if along < least && motor.abs() >= amplitude - least {
            (FaultId::S2, drum)
        } else {
            return Ok(());
        };
        // A speed loop comes to a few newtons within so short a motion: less than the loss of a gear under load. Where
        // its motor did not go all the way, it stood, or only wound up its gear: no evidence of a closed brake or of a
        // dead encoder. Motion shows both within a millimetre (D2, D4, S2); a reversed one is better found at rest.
        let all_the_way = motor.abs() >= amplitude - (amplitude >> 4);
        if by_speed && !all_the_way && fault != FaultId::S4 {
            return Ok(());
        }
        Err(Finding::new(fault, moved / 10, amplitude / 10))
    }
}

/// Duration of a drum's test motion, ticks.
fn oscillation_ticks<const N: usize>(config: &Active<N>, expected_mn: &[i32; N], index: u8) -> u32 {
    let index = usize::from(index);
    let quarter = match (config.cables.get(index), expected_mn.get(index)) {
        (Some(cable), Some(&expected)) => Oscillation::amplitude(cable, expected).1,
        _ => QUARTER,
    };
    12 * quarter
}

/// The name of a drive's silence, with its cable. Where no drive has answered for half of the time after which one is
/// lost, their supply or their bus failed (P2), not one drive. A single winch cannot tell.
#[inline(never)]
pub(crate) fn name_silence<const N: usize>(
    timeout_ms: u16,
    inputs: &Inputs<N>,
    alone: bool,
    (fault, cable): (FaultId, u8),
) -> (FaultId, u8) {
    let mut drives = inputs.drives.iter();
    if !alone && N > 1 && drives.all(|drive| drive.age_ms >= timeout_ms / 2) {
        (FaultId::P2, 0)
    } else {
        (fault, cable)
    }
}

fn alive<const N: usize>(config: &Active<N>, drive: &DriveInput) -> bool {
    // Age too: a drive that was enabled and then fell silent still shows its last, ready state.
    drive.ready && !drive.fault && drive.age_ms < config.feedback_timeout_ms
}

/// A drive or a sensor that came up can still fail: then no brake may open, or stay open.
fn check_drives<const N: usize>(
    config: &Active<N>,
    inputs: &Inputs<N>,
    service: Option<Service>,
) -> Result<(), Abort> {
    for (cable, (drive, &adc)) in (1_u8..).zip(inputs.drives.iter().zip(&inputs.tension_adc)) {
        if !concerns(service, cable) {
            continue;
        }
        check_rails(cable, adc)?;
        if drive.fault {
            return Err((FaultId::D2, cable, 1, 0));
        }
        if !alive(config, drive) {
            let (age, most) = (drive.age_ms, config.feedback_timeout_ms);
            let found = (FaultId::D3, cable);
            let (fault, cable) = name_silence(most, inputs, service.is_some(), found);
            return Err((fault, cable, i32::from(age), i32::from(most)));
        }
    }
    Ok(())
}

fn check_rails(cable: u8, adc: u16) -> Result<(), Abort> {
    let (fault, rail) = match adc {
        adc::RAIL_HIGH.. => (FaultId::S7, adc::RAIL_HIGH),
        ..=adc::RAIL_LOW => (FaultId::S8, adc::RAIL_LOW),
        _ => return Ok(()),
    };
    Err((fault, cable, i32::from(adc), i32::from(rail)))
}

fn check_tensions<const N: usize>(
    config: &Active<N>,
    inputs: &Inputs<N>,
    expected_mn: &[i32; N],
) -> Result<(), Abort> {
    let channels = inputs.tension_adc.iter().zip(expected_mn);
    let channels = config.cables.iter().zip(channels);
    for (cable, (config, (&adc, &expected))) in (1_u8..).zip(channels) {
        check_rails(cable, adc)?;
        let measured = tension::measured_mn(config, adc);
        let band = TENSION_BAND_MN.max(expected / 5);
        if (measured - expected).abs() > band {
            return Err((FaultId::S10, cable, measured, expected));
        }
    }
    Ok(())
}

/// A cable that carries less than its floor may be broken, or off its pulley: no brake opens on it.
/// One that is held by tension may be slack where the host expects that (rigging).
fn check_floors<const N: usize>(
    config: &Active<N>,
    inputs: &Inputs<N>,
    expected_mn: &[i32; N],
) -> Result<(), Abort> {
    let channels = inputs.tension_adc.iter().zip(expected_mn);
    let channels = config.cables.iter().zip(channels);
    for (cable, (config, (&adc, &expected))) in (1_u8..).zip(channels) {
        let measured = tension::measured_mn(config, adc);
        let floor = config.floor_mn;
        let slack = config.control == Control::Tension && expected < floor;
        // A floor of 0 demands nothing; a reading at a rail is the sensor's fault (S8).
        if floor > 0 && !slack && measured < floor && adc::is_plausible(adc) {
            return Err((FaultId::C1, cable, measured, floor));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The verdict on a motor that went as far as this, and its drum, 0.1 µm; an encoder count is 307.
    fn verdict(motor: i32, drum: i32) -> Option<FaultId> {
        let mut motion = Oscillation::default();
        motion.observe(0, 0);
        motion.observe(motor, drum);
        motion.observe(0, 0);
        motion.verdict(614, false).err().map(|found| found.fault)
    }

    #[test]
    fn s2_a_drum_that_stands_is_judged_only_behind_a_motor_that_moved_beyond_its_encoders_count() {
        for away in [1, -1] {
            assert_eq!(verdict(100 * away, 0), Some(FaultId::B1));
            // Against stiff cables: within a count the drum may show nothing.
            assert_eq!(verdict(300 * away, 0), None);
            assert_eq!(verdict(300 * away, -307 * away), Some(FaultId::S4));
            assert_eq!(verdict(470 * away, 0), Some(FaultId::S2));
            assert_eq!(verdict(614 * away, 0), Some(FaultId::S2));
            assert_eq!(verdict(614 * away, 307 * away), None);
        }
    }

    /// Found on `eight-cable` at 30 N: the speed loop wound up the gear by 46 um, and the drum stood.
    #[test]
    fn a_motor_commanded_by_speed_that_only_wound_up_its_gear_is_no_evidence() {
        let found = |motor, drum| {
            let mut motion = Oscillation::default();
            motion.observe(0, 0);
            motion.observe(motor, drum);
            motion.verdict(614, true).err().map(|found| found.fault)
        };
        for away in [1, -1] {
            for (motor, drum) in [(0, 0), (100, 0), (461, 0)] {
                assert_eq!(found(motor * away, drum * away), None, "{motor} {drum}");
            }
            // A drum that turns the other way is taken at its word.
            assert_eq!(found(461 * away, -307 * away), Some(FaultId::S4));
            // All the way, as behind a gear without a load.
            assert_eq!(found(614 * away, 0), Some(FaultId::S2));
            assert_eq!(found(614 * away, -614 * away), Some(FaultId::S4));
            assert_eq!(found(614 * away, 614 * away), None);
        }
    }
}
