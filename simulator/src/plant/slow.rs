//! Slow physics: creep and recovery of cables, warmth of frame and cables, payloads, a knocked anchor.
//!
//! A cable is a spring in series with two Kelvin-Voigt elements: the five-element model of Piao, Jin,
//! Jung, Choi, Park and Park, "Open-loop position control in polymer cable-driven parallel robots via a
//! viscoelastic cable model for high payload workspaces", Advances in Mechanical Engineering 9(12),
//! 2017. Both elements stretch under load and recover without. The material on the drum is taken to
//! have crept like the free part: it was wound under tension.

use super::cable::Cable;
use super::error::PlantError;
use super::params::{PlantParams, PlatformParams};
use super::platform::{Body, Motion};
use super::vec3::{V3, add, axpy, mul, mul_t, scale, sub};
use super::{MAX_CABLES, Plant};

/// Steps of the plant between two of the slow states: 10 ms, a thousandth of the fastest retardation.
pub(super) const EVERY: u64 = 100;

/// A Kelvin-Voigt element: a spring beside a damper.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Voigt {
    /// Final extension over that of the elastic spring under the same tension (no unit).
    pub compliance: f64,
    /// Time in which 63 % of it appear under load, or vanish without (s).
    pub retardation_s: f64,
}

/// Creep of a cable; the default has none.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Creep {
    /// The fast and the slow element.
    pub elements: [Voigt; 2],
}

impl Creep {
    /// Polymer cable (UHMWPE) that creeps by `strain` in the end under `tension_n`, with stiffness
    /// `ea_n`.
    ///
    /// Four tenths come within minutes, the rest within hours: primary creep of a synthetic rope lasts
    /// "a few minutes to a few hours" and is reversible (Samson Rope, "Understanding creep"). The split
    /// and the times of 5 min and 2 h within that are assumptions (ranges: 1 to 10 min, 1 to 5 h).
    ///
    /// ```
    /// let creep = mcdpr_simulator::plant::Creep::polymer(0.003, 10.0, 50_000.0);
    /// // 10 N stretch 50 kN by 0.02 %: 0.3 % are fifteen times as much.
    /// assert!((creep.elements[0].compliance + creep.elements[1].compliance - 15.0).abs() < 1e-9);
    /// ```
    #[must_use]
    pub fn polymer(strain: f64, tension_n: f64, ea_n: f64) -> Self {
        let compliance = strain * ea_n / tension_n;
        Self {
            elements: [
                Voigt {
                    compliance: 0.4 * compliance,
                    retardation_s: 300.0,
                },
                Voigt {
                    compliance: 0.6 * compliance,
                    retardation_s: 7200.0,
                },
            ],
        }
    }

    /// Steel rope: after it has bedded in, at room temperature, next to nothing. One hundredth of the
    /// elastic stretch is an assumption (range: 0 to 0.03).
    #[must_use]
    pub const fn steel() -> Self {
        Self {
            elements: [
                Voigt {
                    compliance: 0.005,
                    retardation_s: 300.0,
                },
                Voigt {
                    compliance: 0.005,
                    retardation_s: 7200.0,
                },
            ],
        }
    }
}

/// Slow physics of a plant. Each part has its own switch; the default has none.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SlowParams {
    /// Creep, one entry per cable; none without entries.
    pub creep: Vec<Creep>,
    /// Thermal expansion of the frame about `frame_center_m` (1/K): aluminium 23e-6, steel 12e-6.
    pub frame_expansion_per_k: f64,
    /// The point of the frame that stays where it is, world (m).
    pub frame_center_m: [f64; 3],
    /// Thermal expansion of the cables (1/K): steel 12e-6, UHMWPE fibre -12e-6 (along the fibre; data
    /// sheets of Dyneema).
    pub cable_expansion_per_k: f64,
    /// How frame and cables warm up by themselves, besides what [`Plant::warm`] says.
    pub warming: Warming,
}

/// Warming of frame and cables towards a temperature, with one time constant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Warming {
    /// Rise in the end (K).
    pub rise_k: f64,
    /// Time in which 63 % of it appear (s).
    pub time_s: f64,
}

impl Warming {
    fn after(self, seconds: f64) -> f64 {
        if self.rise_k == 0.0 {
            return 0.0;
        }
        self.rise_k * (1.0 - libm::exp(-seconds / self.time_s))
    }
}

/// A load that the platform carries, as a point of mass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Payload {
    /// Mass (kg).
    pub mass_kg: f64,
    /// Centre of mass, platform frame (m).
    pub center_m: [f64; 3],
}

/// State of the slow physics.
#[derive(Debug, Clone)]
pub(super) struct Slow {
    params: SlowParams,
    strains: [[f64; 2]; MAX_CABLES],
    warmer_cable_k: f64,
    warmer_frame_k: f64,
    /// Since the start (s).
    seconds: f64,
    /// Anchors at the reference temperature, world (m).
    anchors_m: Vec<V3>,
    /// An anchor that moves: which, world (m/s), and for how long yet (s).
    moving: Option<(usize, V3, f64)>,
    /// The platform without payload.
    platform: PlatformParams,
}

impl Slow {
    pub(super) fn new(params: &PlantParams) -> Self {
        Self {
            params: params.slow.clone(),
            strains: [[0.0; 2]; MAX_CABLES],
            warmer_cable_k: 0.0,
            warmer_frame_k: 0.0,
            seconds: 0.0,
            moving: None,
            anchors_m: params.cables.iter().map(|c| c.anchor_m).collect(),
            platform: params.platform.clone(),
        }
    }

    #[inline(always)]
    pub(super) fn due(&self, steps: u64) -> bool {
        let changes = !self.params.creep.is_empty() || self.params.warming.rise_k != 0.0;
        (changes || self.moving.is_some()) && steps.is_multiple_of(EVERY)
    }

    /// Creep of a cable (strain, no unit).
    pub(super) fn strain(&self, cable: usize) -> f64 {
        self.strains[cable].iter().sum()
    }

    /// Lets time pass under the cables' present tensions. Exact for a constant tension.
    pub(super) fn pass(&mut self, cables: &mut [Cable], seconds: f64) {
        self.seconds += seconds;
        if let Some((cable, speed, left_s)) = self.moving {
            let now_s = left_s.min(seconds);
            self.anchors_m[cable] = axpy(self.anchors_m[cable], now_s, speed);
            self.moving = (left_s > now_s).then_some((cable, speed, left_s - now_s));
        }
        for ((cable, strains), creep) in cables
            .iter_mut()
            .zip(&mut self.strains)
            .zip(&self.params.creep)
        {
            let elastic = cable.tension.elastic_platform_n / cable.ea_n;
            for (strain, element) in strains.iter_mut().zip(&creep.elements) {
                if element.compliance == 0.0 {
                    continue;
                }
                let end = element.compliance * elastic;
                *strain = end + (*strain - end) * libm::exp(-seconds / element.retardation_s);
            }
        }
        self.apply(cables);
    }

    /// Sets temperatures above the reference (K).
    pub(super) fn warm(&mut self, cables: &mut [Cable], frame_k: f64, cable_k: f64) {
        self.warmer_frame_k = frame_k;
        self.warmer_cable_k = cable_k;
        self.apply(cables);
    }

    /// Moves an anchor (world, m).
    pub(super) fn knock(&mut self, cables: &mut [Cable], cable: usize, by_m: V3) {
        self.anchors_m[cable] = add(self.anchors_m[cable], by_m);
        self.apply(cables);
    }

    fn apply(&self, cables: &mut [Cable]) {
        let warmer_k = self.params.warming.after(self.seconds);
        let warmth = self.params.cable_expansion_per_k * (self.warmer_cable_k + warmer_k);
        let grown = self.params.frame_expansion_per_k * (self.warmer_frame_k + warmer_k);
        for (i, cable) in cables.iter_mut().enumerate() {
            cable.growth = 1.0 + self.strain(i) + warmth;
            let from_center = sub(self.anchors_m[i], self.params.frame_center_m);
            cable.pulley.anchor_m = axpy(self.anchors_m[i], grown, from_center);
        }
    }

    /// The platform with a payload.
    pub(super) fn loaded(&self, payload: Option<&Payload>) -> PlatformParams {
        let bare = &self.platform;
        let Some(load) = payload else {
            return bare.clone();
        };
        let mass_kg = bare.mass_kg + load.mass_kg;
        let center = scale(
            axpy(
                scale(bare.center_of_mass_m, bare.mass_kg),
                load.mass_kg,
                load.center_m,
            ),
            1.0 / mass_kg,
        );
        let mut inertia = bare.inertia_kg_m2;
        for (mass, at) in [
            (bare.mass_kg, bare.center_of_mass_m),
            (load.mass_kg, load.center_m),
        ] {
            let arm = sub(at, center);
            let square = super::vec3::dot(arm, arm);
            for (i, row) in inertia.iter_mut().enumerate() {
                for (j, cell) in row.iter_mut().enumerate() {
                    let same = if i == j { square } else { 0.0 };
                    *cell += mass * (same - arm[i] * arm[j]);
                }
            }
        }
        PlatformParams {
            mass_kg,
            center_of_mass_m: center,
            inertia_kg_m2: inertia,
            ..bare.clone()
        }
    }
}

/// Refuses a payload without a positive mass or with a number that is not finite.
pub(super) fn checked(payload: Option<&Payload>) -> Result<(), PlantError> {
    let Some(load) = payload else { return Ok(()) };
    if !(load.mass_kg > 0.0 && load.mass_kg <= 1000.0) {
        return Err(PlantError::Parameter {
            name: "payload mass_kg",
            value: load.mass_kg,
            rule: "above 0 to 1000",
        });
    }
    match load.center_m.into_iter().find(|v| !v.is_finite()) {
        Some(value) => Err(PlantError::Parameter {
            name: "payload center_m",
            value,
            rule: "finite",
        }),
        None => Ok(()),
    }
}

impl Plant {
    /// Sets the temperatures of frame and cables above the reference (K).
    ///
    /// # Errors
    /// [`PlantError::Parameter`] unless -100 to 100 K.
    pub fn warm(&mut self, frame_k: f64, cable_k: f64) -> Result<(), PlantError> {
        for value in [frame_k, cable_k] {
            if !(-100.0..=100.0).contains(&value) {
                return Err(PlantError::Parameter {
                    name: "temperature above the reference",
                    value,
                    rule: "-100 to 100 K",
                });
            }
        }
        self.slow.warm(&mut self.cables, frame_k, cable_k);
        Ok(())
    }

    /// Moves an anchor by `by_m` (world): somebody knocked it.
    ///
    /// # Errors
    /// [`PlantError::NoSuchCable`]; [`PlantError::CableParameter`] if not finite.
    pub fn knock_anchor(&mut self, cable: usize, by_m: [f64; 3]) -> Result<(), PlantError> {
        self.known(cable)?;
        if let Some(value) = by_m.into_iter().find(|v| !v.is_finite()) {
            return Err(PlantError::CableParameter {
                cable,
                name: "knock",
                value,
                rule: "finite",
            });
        }
        self.slow.knock(&mut self.cables, cable, by_m);
        Ok(())
    }

    /// Moves an anchor by `by_m` (world) within `seconds`: somebody leans on it. A second one replaces what is left
    /// of the first.
    ///
    /// # Errors
    /// As [`Plant::knock_anchor`]; [`PlantError::CableParameter`] unless it takes 0.01 to 1000 s.
    pub fn push_anchor(
        &mut self,
        cable: usize,
        by_m: [f64; 3],
        seconds: f64,
    ) -> Result<(), PlantError> {
        self.known(cable)?;
        let numbers = by_m.into_iter().find(|v| !v.is_finite());
        let time = (!(0.01..=1000.0).contains(&seconds)).then_some(seconds);
        if let Some(value) = numbers.or(time) {
            return Err(PlantError::CableParameter {
                cable,
                name: "push",
                value,
                rule: "finite, within 0.01 to 1000 s",
            });
        }
        self.slow.moving = Some((cable, scale(by_m, 1.0 / seconds), seconds));
        Ok(())
    }

    /// Takes a payload that is at rest relative to the platform, or sets the present one down (`None`).
    /// A payload replaces the one before.
    ///
    /// # Errors
    /// [`PlantError::Parameter`] for a mass outside 0 to 1000 kg or a centre that is not finite.
    pub fn carry(&mut self, payload: Option<&Payload>) -> Result<(), PlantError> {
        checked(payload)?;
        let pose = self.motion.pose(&self.body);
        let (origin_velocity, turning) = self.motion.twist(&self.body);
        let old = self.body.clone();
        let platform = self.slow.loaded(payload);
        let body = Body::new(&platform);
        let mut motion = Motion::at_rest(&body, &pose);
        let arm = mul(&pose.matrix(), platform.center_of_mass_m);
        motion.velocity = add(origin_velocity, super::vec3::cross(turning, arm));
        let spin = mul_t(&super::vec3::q_matrix(motion.attitude), turning);
        motion.momentum = [0, 1, 2].map(|i| spin[i] / body.inverse_inertia[i]);
        for (cable, params) in self.cables.iter_mut().zip(&self.params.cables) {
            cable.attachment = body.principal(params.attachment_m);
        }
        // Points of application are kept in principal axes: they move to the new ones.
        self.load.point = body.principal(old.in_platform(self.load.point));
        if let Some(hook) = &mut self.hook {
            hook.point = body.principal(old.in_platform(hook.point));
        }
        self.weight_n = scale(self.params.gravity_mps2, platform.mass_kg);
        self.body = body;
        self.motion = motion;
        Ok(())
    }
}
