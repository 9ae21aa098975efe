//! Arming: enable drives under closed brakes, check the sensors, push against the brakes, open
//! them, stir every drum.

use crate::HAS_SERVICE;
use crate::adc;
use crate::axis::Target;
use crate::config::Active;
use crate::io::{DriveInput, Inputs};
use crate::proof;
use crate::tension;
use mcdpr_protocol::FaultId;

/// Milliseconds that drives may take beyond their own enable time (D5).
const ENABLE_GRACE_MS: u32 = 500;
/// Milliseconds of torque under closed brakes before they are tested.
const PRELOAD_MS: u32 = 30;
/// Milliseconds for the test of the brakes, at most.
const PROOF_MS: u32 = 500;
/// Milliseconds for the platform to come to rest after the drums were stirred: some of its stiff
/// modes, near 10 Hz, ring on for half a second.
const SETTLE_MS: u32 = 500;
/// Milliseconds over which brakes are given to open.
const OPEN_MS: u32 = 50;
/// Tension may differ from what the static model expects by this, mN, or by a fifth of it (S10).
const TENSION_BAND_MN: i32 = 2000;

/// Where arming is.
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
    /// One drum after the other goes out and in a little: brake, encoder and motor agree (B1, S4).
    Stirring(u8),
    /// All is free; waiting for rest.
    Settling,
    /// Done.
    Done,
}

impl Phase {
    /// Whether the brakes have had time to open: the drums are the drives' alone.
    #[must_use]
    pub(crate) const fn is_free(self) -> bool {
        matches!(self, Self::Stirring(_) | Self::Settling | Self::Done)
    }
}

/// Progress of arming.
#[derive(Debug, Clone, Copy, Default)]
pub struct Arming {
    phase: Phase,
    ticks: u32,
}

/// Work on one winch alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Service {
    /// Which, 1 for the first.
    pub cable: u8,
    /// Whether its brake opens.
    pub open: bool,
}

/// Whether a winch (1 for the first) is enabled.
#[must_use]
pub(crate) fn concerns(service: Option<Service>, cable: u8) -> bool {
    !HAS_SERVICE || service.is_none_or(|service| service.cable == cable)
}

/// Why arming is aborted: fault, cable (1 for the first), value, limit.
pub type Abort = (FaultId, u8, i32, i32);

impl Arming {
    /// Where it is.
    #[must_use]
    pub const fn phase(&self) -> Phase {
        self.phase
    }

    /// One tick; `expected_mn` are the tensions that the static model expects, `proven` whether
    /// all brakes hold.
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
        self.ticks += 1;
        if self.phase != Phase::Enabling {
            check_drives(config, inputs, service)?;
        }
        match self.phase {
            Phase::Enabling => {
                let pending = (1_u8..)
                    .zip(&inputs.drives)
                    .find(|(cable, d)| concerns(service, *cable) && !alive(config, d));
                let limit = config.enable_ms + ENABLE_GRACE_MS;
                match pending {
                    None => {
                        if !HAS_SERVICE || service.is_none() {
                            check_tensions(config, inputs, expected_mn)?;
                        }
                        self.enter(Phase::Preload);
                    }
                    Some((cable, _)) if self.ticks >= limit => {
                        let ms = |ticks: u32| i32::try_from(ticks).unwrap_or(i32::MAX);
                        return Err((FaultId::D5, cable, ms(self.ticks), ms(limit)));
                    }
                    Some(_) => {}
                }
            }
            // A closed brake is what shall be tried: until somebody ends it.
            Phase::Preload if HAS_SERVICE && service.is_some_and(|service| !service.open) => {}
            // Nothing hangs on a bare winch: there is no load that its brake must prove to hold.
            Phase::Preload if self.ticks >= PRELOAD_MS => {
                self.enter(if HAS_SERVICE && service.is_some() {
                    Phase::Opening
                } else {
                    Phase::Proving
                });
            }
            Phase::Proving if unproven == 0 => self.enter(Phase::Opening),
            // Neither does a drum move nor does a drive push: it obeys nothing.
            Phase::Proving if self.ticks >= PROOF_MS + u32::from(proof::play_ms(config)) => {
                return Err((FaultId::D7, unproven, 0, 0));
            }
            Phase::Opening if self.ticks >= OPEN_MS => {
                self.enter(if HAS_SERVICE && service.is_some() {
                    Phase::Settling
                } else {
                    Phase::Stirring(0)
                });
            }
            Phase::Stirring(cable) if self.ticks >= Stir::TICKS => {
                let next = cable + 1;
                let more = usize::from(next) < N;
                self.enter(if more {
                    Phase::Stirring(next)
                } else {
                    Phase::Settling
                });
            }
            Phase::Settling if self.ticks >= SETTLE_MS => self.enter(Phase::Done),
            _ => {}
        }
        Ok(self.phase)
    }

    /// Nothing more is tried: torque is on, and stays.
    pub const fn end(&mut self) {
        self.phase = Phase::Done;
        self.ticks = 0;
    }

    fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.ticks = 0;
    }
}

/// A quarter of a lobe of the stirring motion, ticks.
const QUARTER: u32 = 10;
/// Encoder counts that a drum is stirred by.
const STIR_COUNTS: i64 = 2;
/// Most that a drum is stirred by, 0.1 µm, however coarse its encoder.
const STIR_MOST: i64 = 20_000;

/// Acceleration in each quarter, as halves of the largest.
const STIR_HALVES: [i32; 12] = [1, -1, -1, 1, -2, 2, 2, -2, 1, -1, -1, 1];

/// One drum's way out, in and out again: half a lobe, a whole one, half a one. Neither area nor
/// first moment are left, so that the platform, whose swing hardly decays, hardly swings.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Stir {
    ticks: u32,
    /// Displacement and speed now, 1/256 of 0.1 µm and of 0.1 µm/ms.
    at_q8: i32,
    speed_q8: i32,
    /// The length to come back to, 0.1 µm.
    base: Option<i32>,
    /// Where motor and drum were before, 0.1 µm.
    from: Option<(i32, i32)>,
    /// Farthest that the motor came, and where the drum was then, 0.1 µm.
    farthest: (i32, i32),
}

impl Stir {
    /// Duration, ticks.
    pub(crate) const TICKS: u32 = 12 * QUARTER;

    /// How far a drum is stirred, 0.1 µm, for its encoder's resolution.
    #[must_use]
    pub fn amplitude(per_count_q24: i64) -> i32 {
        let counts = (per_count_q24.abs() * STIR_COUNTS) >> 24;
        crate::fixed::saturate(counts.clamp(16, STIR_MOST))
    }

    /// The length that the drum was stirred about, 0.1 µm.
    #[must_use]
    pub fn base(&self, length: i32) -> i32 {
        self.base.unwrap_or(length)
    }

    /// One tick: what the drum shall do. `length` is its target before the first.
    pub fn step(&mut self, amplitude: i32, length: i32) -> Target {
        let base = *self.base.get_or_insert(length);
        let quarter = usize::try_from(self.ticks / QUARTER).unwrap_or(usize::MAX);
        let halves = STIR_HALVES.get(quarter).copied().unwrap_or(0);
        let square = QUARTER.cast_signed() * QUARTER.cast_signed();
        let acceleration_q8 = halves * ((amplitude << 7) / square);
        self.at_q8 += self.speed_q8 + acceleration_q8 / 2;
        self.speed_q8 += acceleration_q8;
        self.ticks += 1;
        // 0.1 µm/ms is 100 µm/s, 0.1 µm/ms² is 100 000 µm/s².
        let acceleration = (acceleration_q8 * 390).saturating_add(acceleration_q8 / 2);
        Target {
            length: base.saturating_add(self.at_q8 >> 8),
            speed_umps: (self.speed_q8 * 100) >> 8,
            acceleration_umps2: acceleration,
        }
    }

    /// Sees where motor and drum are, 0.1 µm.
    pub fn observe(&mut self, motor: i32, drum: i32) {
        let from = *self.from.get_or_insert((motor, drum));
        let gone = (motor.wrapping_sub(from.0), drum.wrapping_sub(from.1));
        if gone.0.unsigned_abs() > self.farthest.0.unsigned_abs() {
            self.farthest = gone;
        }
    }

    /// What the whole way has shown.
    ///
    /// # Errors
    /// B1 where the motor could not turn, S4 where the drum turned the other way, S2 where it did
    /// not turn at all; with how far it came and how far it should, µm.
    pub fn verdict(&self, amplitude: i32) -> Result<(), (FaultId, i32, i32)> {
        let (motor, drum) = self.farthest;
        let along = if motor < 0 { -drum } else { drum };
        let least = amplitude / 4;
        let fault = if motor.abs() < least {
            (FaultId::B1, motor)
        } else if along < -least {
            (FaultId::S4, drum)
        } else if along < least {
            (FaultId::S2, drum)
        } else {
            return Ok(());
        };
        Err((fault.0, fault.1 / 10, amplitude / 10))
    }
}

fn alive<const N: usize>(config: &Active<N>, drive: &DriveInput) -> bool {
    drive.ready && !drive.fault && drive.age_ms < config.feedback_timeout_ms
}

/// A drive or a sensor that came up can still go: no brake may open on it, or stay open.
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
            return Err((FaultId::D3, cable, i32::from(age), i32::from(most)));
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
