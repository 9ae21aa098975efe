//! The machine of a day: the plant, its sensors, its camera. The truth stays in here.

use crate::plant::{AfterHours, Mismatch, plant_params};
use mcdpr_core::random::Random;
use mcdpr_core::robot::{Robot, Tag, TagPlace};
use mcdpr_core::sight::TagView;
use mcdpr_simulator::plant::{DayHold, DayPlant, DayState, Payload, PlantError, Pose, SensorDrift};
use nalgebra::{Matrix3, Rotation3, Vector3};

/// Noise of a corner, mean of the pictures of one look, px: 0.1 px in thirty pictures leave 0.02, and
/// the detector's own bias from place to place 0.04.
pub(super) const CORNER_PX: f64 = 0.05;
/// Noise of a tension, N: mean over a second (neighbouring readings are alike), and of one reading.
const TENSION_N: f64 = 0.01;
const READING_N: f64 = 0.05;
/// Side and distance of the mat's tags, m.
const TAG_M: f64 = 0.08;
const PITCH_M: f64 = 0.11;

/// Something that somebody knocks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Knock {
    /// An anchor (from 0), by this much, world, m.
    Anchor(usize, [f64; 3]),
    /// The camera: shift, m, and turn, rad, in its own frame.
    Camera([f64; 3], [f64; 3]),
}

/// What encoders (as drum displacement, m) and tension sensors (N) show at one moment.
#[derive(Debug)]
pub(super) struct Sensed {
    pub(super) encoders_m: Vec<f64>,
    pub(super) readings_n: Vec<f64>,
}

/// The machine.
#[derive(Debug)]
pub(super) struct Machine {
    plant: DayPlant,
    hours: AfterHours,
    random: Random,
    lens: [f64; 4],
    picture: [f64; 2],
    /// camera_from_platform as it is mounted.
    mount: (Rotation3<f64>, Vector3<f64>),
    tags: Vec<Tag>,
    place: TagPlace,
    counts_per_m: Vec<f64>,
    phase: Vec<f64>,
    sensor_gain: Vec<f64>,
    drift: Vec<SensorDrift>,
    seconds: f64,
    held: Vec<bool>,
}

impl Clone for Machine {
    fn clone(&self) -> Self {
        Self {
            plant: self.plant.clone(),
            hours: self.hours,
            random: Random::new(self.seconds.to_bits()),
            tags: self.tags.clone(),
            counts_per_m: self.counts_per_m.clone(),
            phase: self.phase.clone(),
            sensor_gain: self.sensor_gain.clone(),
            drift: self.drift.clone(),
            held: self.held.clone(),
            ..*self
        }
    }
}

/// The mat: nine tags in a square, as the calibration's board has them.
pub(super) fn mat() -> Vec<Tag> {
    let h = TAG_M / 2.0;
    (0..9)
        .map(|id| {
            let (x, y) = (
                f64::from(id / 3) * PITCH_M - PITCH_M,
                f64::from(id % 3) * PITCH_M - PITCH_M,
            );
            let corner = |sx: f64, sy: f64| Vector3::new(x + sx * h, y + sy * h, 0.0);
            Tag {
                id,
                family: "36h11".to_owned(),
                size_m: TAG_M,
                body: 0,
                corners_in_body_m: [
                    corner(-1.0, -1.0),
                    corner(1.0, -1.0),
                    corner(1.0, 1.0),
                    corner(-1.0, 1.0),
                ],
            }
        })
        .collect()
}

impl Machine {
    /// The machine of a robot, off by what is drawn with `seed`, at rest near a pose under tensions.
    ///
    /// # Errors
    /// Where it does not hang there.
    pub(super) fn new(
        robot: &Robot,
        mismatch: &Mismatch,
        seed: u64,
        pose: &mcdpr_kinematics::Pose,
        tensions_n: &[f64],
        held: &[usize],
        place: TagPlace,
    ) -> Result<Self, PlantError> {
        let params = plant_params(robot, mismatch, seed);
        let hours = mismatch.hours.unwrap_or(AfterHours::polymer());
        let mut random = Random::new(seed ^ 0x6461_7900);
        let nominal = |i: usize| robot.winch_of(i).map_or(1.0, |w| w.tension_gain_n_per_v);
        let sensors = params.winches.iter().enumerate();
        let sensor_gain = sensors
            .map(|(i, w)| nominal(i) / w.sensor.gain_n_per_v)
            .collect();
        let counts_per_m = params
            .winches
            .iter()
            .map(|w| w.encoder_counts_per_turn / (std::f64::consts::TAU * w.drum_radius_m))
            .collect();
        let count = params.cables.len();
        let drift = (0..count)
            .map(|_| SensorDrift {
                steady_n: 0.5 * hours.drift_n * random.normal(),
                wave_n: 0.5 * hours.drift_n * random.normal(),
                phase_rad: 6.0 * random.unit(),
            })
            .collect();
        let phase = (0..count).map(|_| random.unit()).collect();
        let [shift, turn] = hours.camera;
        let nominal = &robot.camera.camera_from_platform;
        let mount = (
            Rotation3::new(Vector3::from_fn(|_, _| turn * random.normal())) * nominal.rotation,
            nominal.position_m + Vector3::from_fn(|_, _| shift * random.normal()),
        );
        let lens = &robot.camera.lens;
        let matrix = pose.rotation.matrix();
        let rows = [0, 1, 2].map(|row| [0, 1, 2].map(|column| matrix[(row, column)]));
        let start = Pose::from_matrix(pose.position_m.into(), &rows)?;
        let mut plant = DayPlant::new(params, &start, tensions_n)?;
        let holds: Vec<DayHold> = (0..count)
            .map(|i| {
                if held.contains(&i) {
                    DayHold::Tension(tensions_n[i])
                } else {
                    DayHold::Drum(0.0)
                }
            })
            .collect();
        plant.rest(&holds)?;
        Ok(Self {
            plant,
            hours,
            random,
            lens: [
                lens.focal_px[0],
                lens.focal_px[1],
                lens.center_px[0],
                lens.center_px[1],
            ],
            picture: lens.size_px.map(|size| size as f64),
            mount,
            tags: mat(),
            place,
            counts_per_m,
            phase,
            sensor_gain,
            drift,
            seconds: 0.0,
            held: (0..count).map(|i| held.contains(&i)).collect(),
        })
    }

    /// The truth, for judging.
    #[must_use]
    pub(super) fn truth(&self) -> DayState {
        self.plant.state()
    }

    /// Paid-out lengths at first as a calibration would know them, m.
    pub(super) fn lengths_at_first_m(&mut self) -> Vec<f64> {
        let sigma = self.hours.length_m;
        let random = &mut self.random;
        let state = self.plant.state();
        (0..self.held.len())
            .map(|i| {
                state.paid_out_at_first_m[i] + state.drum_positions_m[i] + sigma * random.normal()
            })
            .collect()
    }

    /// Drum displacement at the start, m: the encoders' zero.
    pub(super) fn drums_m(&self) -> Vec<f64> {
        self.plant.state().drum_positions_m[..self.held.len()].to_vec()
    }

    fn zero_n(&self, cable: usize) -> f64 {
        self.drift[cable].zero_n(self.seconds)
    }

    /// Lets the winches go to these drum displacements (m), or sensor readings (N) where a tension is held. What the sensors
    /// show on the way, as telemetry would.
    ///
    /// # Errors
    /// Where the platform does not hang.
    pub(super) fn go(
        &mut self,
        drums_m: &[f64],
        readings_n: &[f64],
    ) -> Result<Vec<Sensed>, PlantError> {
        let holds: Vec<DayHold> = (0..self.held.len())
            .map(|i| {
                if self.held[i] {
                    let true_n = (readings_n[i] - self.zero_n(i)) / self.sensor_gain[i];
                    DayHold::Tension(true_n)
                } else {
                    DayHold::Drum(drums_m[i])
                }
            })
            .collect();
        let mut states = Vec::new();
        self.plant
            .rest_by_way_of(&holds, &mut |plant| states.push(plant.state()))?;
        let mut way = Vec::with_capacity(states.len());
        for state in &states {
            way.push(Sensed {
                encoders_m: self.counted_m(state),
                readings_n: (0..self.held.len())
                    .map(|i| self.read_n(state, i) + READING_N * self.random.normal())
                    .collect(),
            });
        }
        Ok(way)
    }

    /// Lets a second or more pass.
    pub(super) fn pass(&mut self, seconds: f64) {
        self.seconds += seconds;
        self.plant.pass(seconds);
    }

    /// What the encoders show, as drum displacement, m.
    pub(super) fn encoders_m(&self) -> Vec<f64> {
        self.counted_m(&self.plant.state())
    }

    fn counted_m(&self, state: &DayState) -> Vec<f64> {
        (0..self.held.len())
            .map(|i| {
                let (per_m, phase) = (self.counts_per_m[i], self.phase[i]);
                ((state.drum_positions_m[i] * per_m + phase).floor() + 0.5 - phase) / per_m
            })
            .collect()
    }

    /// What the tension sensors show, mean of a second, N.
    pub(super) fn readings_n(&mut self) -> Vec<f64> {
        let state = self.plant.state();
        (0..self.held.len())
            .map(|i| self.read_n(&state, i) + TENSION_N * self.random.normal())
            .collect()
    }

    /// What a sensor shows without noise, N.
    fn read_n(&self, state: &DayState, cable: usize) -> f64 {
        state.tensions_winch_n[cable] * self.sensor_gain[cable] + self.zero_n(cable)
    }

    pub(super) fn carry(&mut self, load: Option<&Payload>) -> Result<(), PlantError> {
        self.plant.carry(load)
    }

    /// Knocks something.
    ///
    /// # Errors
    /// If there is no such cable.
    pub(super) fn knock(&mut self, knock: &Knock) -> Result<(), PlantError> {
        match knock {
            Knock::Anchor(cable, by_m) => self.plant.knock_anchor(*cable, *by_m),
            Knock::Camera(shift, turn) => {
                let turn = Rotation3::new(Vector3::from(*turn));
                self.mount = (
                    turn * self.mount.0,
                    turn * self.mount.1 + Vector3::from(*shift),
                );
                Ok(())
            }
        }
    }

    /// The tags in the picture now: a pinhole's projection of the true corners, with noise.
    pub(super) fn look(&mut self) -> Vec<TagView> {
        let state = self.plant.state();
        let rows = state.pose.matrix();
        let back = Matrix3::from_fn(|i, j| rows[j][i]);
        let [fx, fy, cx, cy] = self.lens;
        let variance = CORNER_PX * CORNER_PX;
        let mut views = Vec::new();
        for tag in &self.tags {
            let mut corners_px = [[0.0; 2]; 4];
            let mut whole = true;
            for (slot, corner) in corners_px.iter_mut().zip(&tag.corners_in_body_m) {
                let body = &self.place.world_from_body;
                let world = body.rotation.matrix() * corner + body.position_m;
                let platform = back * (world - Vector3::from(state.pose.position_m));
                let seen = self.mount.0 * platform + self.mount.1;
                *slot = [
                    fx * seen.x / seen.z + cx + CORNER_PX * self.random.normal(),
                    fy * seen.y / seen.z + cy + CORNER_PX * self.random.normal(),
                ];
                whole &= seen.z > 0.05
                    && (0.0..self.picture[0]).contains(&slot[0])
                    && (0.0..self.picture[1]).contains(&slot[1]);
            }
            if whole {
                views.push(TagView {
                    id: tag.id,
                    corners_px,
                    covariance_px2: [[[variance, 0.0], [0.0, variance]]; 4],
                    image_time_us: 0,
                });
            }
        }
        views
    }
}
