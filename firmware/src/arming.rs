//! Arming: enable drives under closed brakes, check the sensors, take up torque, open brakes.

use crate::config::Active;
use crate::io::{DriveInput, Inputs};
use crate::tension;
use mcdpr_protocol::FaultId;

/// Milliseconds that drives may take beyond their own enable time (D5).
const ENABLE_GRACE_MS: u32 = 500;
/// Milliseconds of torque under closed brakes.
const PRELOAD_MS: u32 = 100;
/// Milliseconds for the platform to come to rest after the brakes opened.
const SETTLE_MS: u32 = 200;
/// Milliseconds over which brakes are given to open.
const OPEN_MS: u32 = 50;
/// Tension may differ from what the static model expects by this, mN, or by a fifth of it (S10).
const TENSION_BAND_MN: i32 = 2000;

/// Where arming is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Phase {
    /// Drives enable; brakes closed.
    #[default]
    Enabling,
    /// Drives give torque against closed brakes.
    Preload,
    /// Brakes open.
    Opening,
    /// All is free; waiting for rest.
    Settling,
    /// Done.
    Done,
}

/// Progress of arming.
#[derive(Debug, Clone, Copy, Default)]
pub struct Arming {
    phase: Phase,
    ticks: u32,
}

/// Whether this build can work on one bare winch.
pub const HAS_SERVICE: bool = cfg!(feature = "service");

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
pub fn concerns(service: Option<Service>, cable: u8) -> bool {
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

    /// One tick; `expected_mn` are the tensions that the static model expects.
    ///
    /// # Errors
    /// The check that failed.
    pub fn tick<const N: usize>(
        &mut self,
        config: &Active<N>,
        inputs: &Inputs<N>,
        expected_mn: &[i32; N],
        service: Option<Service>,
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
            Phase::Preload if self.ticks >= PRELOAD_MS => self.enter(Phase::Opening),
            Phase::Opening if self.ticks >= OPEN_MS => self.enter(Phase::Settling),
            Phase::Settling if self.ticks >= SETTLE_MS => self.enter(Phase::Done),
            _ => {}
        }
        Ok(self.phase)
    }

    fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        self.ticks = 0;
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
        tension::ADC_RAIL_HIGH.. => (FaultId::S7, tension::ADC_RAIL_HIGH),
        ..=tension::ADC_RAIL_LOW => (FaultId::S8, tension::ADC_RAIL_LOW),
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
