//! An external physics engine in place of the plant's platform and cables. Winches, drives, brakes
//! and sensors stay the plant's: a control core can be tested on physics that this project did not
//! write.

use super::Plant;
use super::cable::Tension;
use super::error::PlantError;
use super::params::MAX_CABLES;
use super::platform::{Motion, Pose};
use std::fmt;
use std::sync::{Arc, Mutex};

/// Step of the external engine, s: light winches on stiff cables react within a millisecond.
const EVERY_S: f64 = 2e-4;

/// The load on the winches according to the external engine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hanging {
    /// The platform's frame in the world.
    pub pose: Pose,
    /// Tension of each cable (N); entries beyond the robot's cables do nothing.
    pub tensions_n: [f64; MAX_CABLES],
}

/// An external engine.
pub trait Foreign: Send {
    /// Advances by `duration_s`, at whose end each cable is unstretched `paid_out_m` long from
    /// anchor to attachment and grows by `rates_mps`.
    ///
    /// # Errors
    /// Why it cannot continue.
    fn advance(
        &mut self,
        paid_out_m: &[f64],
        rates_mps: &[f64],
        duration_s: f64,
    ) -> Result<Hanging, String>;
}

/// The external engine of a plant. Copies of the plant share it.
#[derive(Clone)]
pub(super) struct Outside {
    engine: Arc<Mutex<dyn Foreign>>,
    tensions_n: [f64; MAX_CABLES],
}

impl fmt::Debug for Outside {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Outside")
            .field("tensions_n", &self.tensions_n)
            .finish_non_exhaustive()
    }
}

impl Plant {
    /// From now on another engine has the platform and the cables. Loads, hooks, slipped and broken
    /// cables and losses at pulleys are its affair then; the truth has its pose and its tensions, and
    /// no velocities.
    pub fn set_foreign(&mut self, engine: impl Foreign + 'static) {
        let tensions = self.cables.iter().map(|cable| cable.tension.platform_n);
        let mut tensions_n = [0.0; MAX_CABLES];
        for (slot, tension) in tensions_n.iter_mut().zip(tensions) {
            *slot = tension;
        }
        self.outside = Some(Outside {
            engine: Arc::new(Mutex::new(engine)),
            tensions_n,
        });
    }

    /// Tensions of the external engine, if there is one.
    pub(super) fn outside_tension(&self, cable: usize) -> Option<f64> {
        let outside = self.outside.as_ref()?;
        outside.tensions_n.get(cable).copied()
    }

    /// One step of the winches with the external engine's tensions, and a step of that engine when
    /// it is due.
    pub(super) fn step_outside(&mut self, now_s: f64) -> Result<(), PlantError> {
        let h = self.params.step_s;
        let Some(outside) = &self.outside else {
            return Ok(());
        };
        let tensions_n = outside.tensions_n;
        for (i, (cable, winch)) in self.cables.iter_mut().zip(&mut self.winches).enumerate() {
            winch.drift(0.5 * h);
            // The engine's tension acts unchanged: pulleys and their losses are part of the engine.
            let tension_n = tensions_n[i];
            cable.tension = Tension {
                platform_n: tension_n,
                winch_n: tension_n,
                elastic_platform_n: tension_n,
            };
            let pull_n = winch.paid_out().lever * tension_n;
            winch.kick(pull_n, now_s, h, &self.faults.cables[i].brake);
            winch.drift(0.5 * h);
        }
        self.steps += 1;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "some steps of a tenth of a millisecond"
        )]
        let every = (EVERY_S / h).round().max(1.0) as u64;
        if !self.steps.is_multiple_of(every) {
            return Ok(());
        }
        let count = self.cables.len();
        let (mut paid_out_m, mut rates_mps) = ([0.0; MAX_CABLES], [0.0; MAX_CABLES]);
        for (i, (cable, winch)) in self.cables.iter().zip(&self.winches).enumerate() {
            let off_drum = winch.paid_out();
            paid_out_m[i] = cable.unstretched_m(off_drum.length_m) - cable.routing_m;
            rates_mps[i] = off_drum.rate_mps;
        }
        let failed = |reason: String| PlantError::Board { reason };
        let gone = || failed("the other engine is in use".to_owned());
        let hanging = {
            let mut engine = outside.engine.lock().map_err(|_| gone())?;
            engine
                .advance(&paid_out_m[..count], &rates_mps[..count], every as f64 * h)
                .map_err(|reason| failed(format!("the other engine: {reason}")))?
        };
        // Refused before they reach the winches: one NaN would spread to every state.
        let finite = hanging.tensions_n.iter().all(|t| t.is_finite());
        if !finite {
            return Err(PlantError::Diverged { time_s: now_s });
        }
        // The engine reports poses without velocities.
        self.motion = Motion::at_rest(&self.body, &hanging.pose);
        if let Some(outside) = &mut self.outside {
            outside.tensions_n = hanging.tensions_n;
        }
        Ok(())
    }
}
