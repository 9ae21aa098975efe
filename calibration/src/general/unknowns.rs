//! The unknowns of a real machine: their order, names and priors.

use super::data::{Eye, Set};

/// Standard deviations of the priors about the entered values.
///
/// The widths are those of a real four-cable robot's logs (IRMA4U, University of Bologna, logs of
/// March 2025 in fzoffoli/UACDPR_SelfCalibration): load cells -6 to +14 % and up to +20 N off,
/// drums 0.2 to 0.7 %, 0.5 to 1.5 mm per homing, an inclinometer mounted 1.6 degrees off, centre of
/// mass 3 to 5 mm, pulleys that lose 1.3 to 2.3 %.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Priors {
    /// Gain of each load cell, share.
    pub gain: f64,
    /// Zero of each load cell, N.
    pub zero_n: f64,
    /// Zero of each load cell from session to session, N.
    pub zero_session_n: f64,
    /// Gain of each drum, share.
    pub drum: f64,
    /// Offset of each absolute length, m.
    pub offset_m: f64,
    /// Offset of each length from homing to homing, m.
    pub homing_m: f64,
    /// Offset of a length that is reported as a change only, m.
    pub change_m: f64,
    /// Mean and standard deviation of the tension that a pulley loses over half a turn, share.
    pub loss: [f64; 2],
    /// Offset of each swivel sensor, rad.
    pub swivel_rad: f64,
    /// The same from session to session, rad.
    pub swivel_session_rad: f64,
    /// Pulley radius, m.
    pub radius_m: f64,
    /// Each coordinate of an anchor, m.
    pub anchor_m: f64,
    /// Each coordinate of an attachment, m.
    pub attachment_m: f64,
    /// Each coordinate of the centre of mass, m.
    pub center_of_mass_m: f64,
    /// Mass, share.
    pub mass: f64,
    /// 1/EA of all cables, 1/N.
    pub compliance_per_n: f64,
    /// What each cable's adds to that, 1/N. By default next to nothing: with cables of one make few data tell them
    /// apart.
    pub own_compliance_per_n: f64,
    /// Each angle of the inclinometer's mounting, rad.
    pub mount_rad: f64,
    /// The same from session to session, rad.
    pub mount_session_rad: f64,
    /// Yaw at a session's start, rad, and its drift, rad/s.
    pub yaw_rad: f64,
    /// Drift of the yaw, rad/s.
    pub yaw_rate_rps: f64,
    /// Focal length, share.
    pub focal: f64,
    /// Principal point, px.
    pub center_px: f64,
    /// The lens's k1.
    pub k1: f64,
    /// Size of the tags, share.
    pub tag: f64,
}

impl Default for Priors {
    fn default() -> Self {
        Self {
            gain: 0.1,
            zero_n: 10.0,
            zero_session_n: 1.5,
            drum: 0.01,
            offset_m: 0.01,
            homing_m: 6e-4,
            change_m: 1.0,
            loss: [0.01, 0.02],
            swivel_rad: 0.05,
            swivel_session_rad: 5e-3,
            radius_m: 5e-4,
            anchor_m: 1e-3,
            attachment_m: 5e-4,
            center_of_mass_m: 0.01,
            mass: 0.02,
            compliance_per_n: 2e-5,
            own_compliance_per_n: 1e-10,
            mount_rad: 0.03,
            mount_session_rad: 3e-3,
            yaw_rad: 0.2,
            yaw_rate_rps: 5e-4,
            focal: 1e-3,
            center_px: 1.0,
            k1: 5e-4,
            tag: 1e-3,
        }
    }
}

impl Priors {
    /// For readings that are used only through their changes: offset, zero and mounting are
    /// unknown.
    #[must_use]
    pub(crate) fn changes_only() -> Self {
        Self {
            zero_n: 100.0,
            offset_m: 1.0,
            swivel_rad: 0.5,
            mount_rad: 0.05,
            yaw_rad: 0.5,
            ..Self::default()
        }
    }
}

/// Standard deviation of a target's place on the platform if it is not stated, m.
const UNKNOWN_TARGET_M: f64 = 1.0;

/// Unknowns per cable: gain, zero, drum, offset, loss, swivel, radius, anchor, attachment, own compliance.
const PER_CABLE: usize = 14;
/// Centre of mass, mass, compliance, mounting.
const COMMON: usize = 8;
/// Camera's place, focal length, principal point, k1, tag size.
const CAMERA: usize = 11;

/// Index of each unknown in the vector.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    /// Number of cables.
    pub cables: usize,
    /// Number of rigid bodies of tags; `None` without a camera.
    pub bodies: Option<usize>,
    /// The trackers that take part, as indices into the set's.
    pub trackers: Vec<usize>,
    /// The tapes that take part, as indices into the set's.
    pub tapes: Vec<usize>,
    /// The sessions that take part, as indices into the set's.
    pub sessions: Vec<usize>,
    /// Cables that slipped: cable, and the sample from which on it holds.
    pub breaks: Vec<Break>,
}

/// A cable whose length has jumped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Break {
    /// Index of the cable.
    pub cable: usize,
    /// Session in which it jumped.
    pub session: usize,
    /// Index of the first sample after it.
    pub from: usize,
}

#[allow(missing_docs)] // The names say it.
impl Layout {
    #[must_use]
    pub fn gain(&self, i: usize) -> usize {
        PER_CABLE * i
    }
    #[must_use]
    pub fn zero(&self, i: usize) -> usize {
        PER_CABLE * i + 1
    }
    #[must_use]
    pub fn drum(&self, i: usize) -> usize {
        PER_CABLE * i + 2
    }
    #[must_use]
    pub fn offset(&self, i: usize) -> usize {
        PER_CABLE * i + 3
    }
    #[must_use]
    pub fn loss(&self, i: usize) -> usize {
        PER_CABLE * i + 4
    }
    #[must_use]
    pub(crate) fn swivel(&self, i: usize) -> usize {
        PER_CABLE * i + 5
    }
    #[must_use]
    pub fn radius(&self, i: usize) -> usize {
        PER_CABLE * i + 6
    }
    #[must_use]
    pub fn anchor(&self, i: usize) -> usize {
        PER_CABLE * i + 7
    }
    #[must_use]
    pub fn attachment(&self, i: usize) -> usize {
        PER_CABLE * i + 10
    }
    /// Of one cable, beyond that of all.
    #[must_use]
    pub(crate) fn own_compliance(&self, i: usize) -> usize {
        PER_CABLE * i + 13
    }
    #[must_use]
    pub(crate) fn center_of_mass(&self) -> usize {
        PER_CABLE * self.cables
    }
    #[must_use]
    pub fn mass(&self) -> usize {
        self.center_of_mass() + 3
    }
    #[must_use]
    pub(crate) fn compliance(&self) -> usize {
        self.center_of_mass() + 4
    }
    #[must_use]
    pub(crate) fn mount(&self) -> usize {
        self.center_of_mass() + 5
    }
    /// First of the camera's: place (6), focal length, principal point (2), k1, tag size.
    #[must_use]
    pub fn camera(&self) -> usize {
        self.center_of_mass() + COMMON
    }
    #[must_use]
    pub fn body(&self, body: usize) -> usize {
        self.camera() + CAMERA + 6 * body
    }
    pub(crate) fn after_camera(&self) -> usize {
        self.bodies
            .map_or_else(|| self.camera(), |bodies| self.body(bodies))
    }
    fn session(&self, slot: usize) -> usize {
        self.after_outside() + slot * (3 * self.cables + 4)
    }
    #[must_use]
    pub(crate) fn zero_of(&self, slot: usize, i: usize) -> usize {
        self.session(slot) + i
    }
    #[must_use]
    pub(crate) fn offset_of(&self, slot: usize, i: usize) -> usize {
        self.session(slot) + self.cables + i
    }
    #[must_use]
    pub(crate) fn swivel_of(&self, slot: usize, i: usize) -> usize {
        self.session(slot) + 2 * self.cables + i
    }
    #[must_use]
    pub(crate) fn mount_of(&self, slot: usize) -> usize {
        self.session(slot) + 3 * self.cables
    }
    /// Yaw at the start, then its drift.
    #[must_use]
    pub(crate) fn yaw_of(&self, slot: usize) -> usize {
        self.session(slot) + 3 * self.cables + 2
    }
    #[must_use]
    pub fn jump(&self, k: usize) -> usize {
        self.session(self.sessions.len()) + k
    }
    #[must_use]
    pub fn len(&self) -> usize {
        self.jump(self.breaks.len())
    }
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.cables == 0
    }
    /// Unknowns of one sample: the pose's displacement and the tensions at the platform.
    #[must_use]
    pub fn own(&self) -> usize {
        6 + self.cables
    }
    /// Slot of a session of the set.
    #[must_use]
    pub fn slot(&self, session: usize) -> Option<usize> {
        self.sessions.iter().position(|s| *s == session)
    }
}

/// One unknown: name, start value, prior.
#[derive(Debug, Clone, PartialEq)]
pub struct Unknown {
    /// In words, as in "cable 2's drum".
    pub name: String,
    /// Expected value.
    pub mean: f64,
    /// Standard deviation; infinite without prior knowledge.
    pub sigma: f64,
    /// How it is printed.
    pub unit: Unit,
    /// The value entered in the robot's description, if it is a measured constant.
    pub entered: Option<f64>,
}

/// All unknowns in the layout's order.
#[must_use]
pub(crate) fn unknowns(set: &Set, layout: &Layout, priors: &Priors) -> Vec<Unknown> {
    let mut list = List {
        out: Vec::with_capacity(layout.len()),
        set,
        layout,
        priors,
    };
    for index in 0..set.robot.cables.len() {
        list.cable(index);
    }
    list.platform();
    if let (Some(bodies), Some(eye)) = (layout.bodies, &set.eye) {
        list.eye(eye, bodies);
    }
    for &tracker in &layout.trackers {
        list.tracker(tracker);
    }
    for &tape in &layout.tapes {
        if let Some(tape) = set.tapes.get(tape) {
            let name = format!("the zero of tape {}", tape.name);
            list.free(name, tape.tolerance_m, MM);
        }
    }
    for &session in &layout.sessions {
        list.session(session);
    }
    for jump in &layout.breaks {
        let name = format!("cable {}'s slip at {}", jump.cable + 1, set.name(jump.from));
        // A slip of 5 cm is one standard deviation: wide enough to leave its size to the data.
        list.free(name, 0.05, MM);
    }
    list.out
}

/// How a value is printed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unit {
    /// Printed value per SI value.
    pub factor: f64,
    /// Symbol of the printed unit.
    pub symbol: &'static str,
}

impl Unit {
    pub(crate) const fn new(factor: f64, symbol: &'static str) -> Self {
        Self { factor, symbol }
    }
}

const PERCENT: Unit = Unit::new(100.0, "%");
const MM: Unit = Unit::new(1e3, "mm");
const N: Unit = Unit::new(1.0, "N");
const DEGREES: Unit = Unit::new(180.0 / std::f64::consts::PI, "deg");
const AXES: [&str; 3] = ["x", "y", "z"];

/// The unknowns so far; its methods add those of one part in the layout's order.
struct List<'a> {
    out: Vec<Unknown>,
    set: &'a Set,
    layout: &'a Layout,
    priors: &'a Priors,
}

impl List<'_> {
    fn add(&mut self, name: String, mean: f64, sigma: f64, unit: Unit, entered: Option<f64>) {
        self.out.push(Unknown {
            name,
            mean,
            sigma,
            unit,
            entered,
        });
    }

    /// An unknown about zero.
    fn free(&mut self, name: String, sigma: f64, unit: Unit) {
        self.add(name, 0.0, sigma, unit, None);
    }

    /// The change of a constant that was entered.
    fn entered(&mut self, name: String, sigma: f64, unit: Unit, value: f64) {
        self.add(name, 0.0, sigma, unit, Some(value));
    }

    fn cable(&mut self, index: usize) {
        let (priors, robot) = (self.priors, &self.set.robot);
        let Some(cable) = robot.cables.get(index) else {
            return;
        };
        let offset = if robot.absolute {
            priors.offset_m
        } else {
            priors.change_m
        };
        let anchor = robot
            .anchor_half_tolerance_m
            .map_or(priors.anchor_m, |half| half / 3f64.sqrt());
        let of = format!("cable {}'s", index + 1);
        self.free(format!("{of} cell gain"), priors.gain, PERCENT);
        self.free(format!("{of} cell zero"), priors.zero_n, N);
        self.free(format!("{of} drum"), priors.drum, PERCENT);
        self.free(format!("{of} length offset"), offset, MM);
        let [mean, sigma] = priors.loss;
        self.add(format!("{of} pulley loss"), mean, sigma, PERCENT, None);
        self.free(format!("{of} swivel offset"), priors.swivel_rad, DEGREES);
        let radius = cable.pulley_radius_m;
        // An eyelet has no radius to estimate.
        let sigma = if radius > 0.0 { priors.radius_m } else { 1e-9 };
        self.entered(format!("{of} pulley radius"), sigma, MM, radius);
        for (axis, at) in AXES.iter().zip(&cable.anchor_m) {
            self.entered(format!("{of} anchor in {axis}"), anchor, MM, *at);
        }
        for (axis, at) in AXES.iter().zip(&cable.attachment_m) {
            let name = format!("{of} attachment in {axis}");
            self.entered(name, priors.attachment_m, MM, *at);
        }
        let name = format!("{of} own compliance");
        self.free(name, priors.own_compliance_per_n, Unit::new(1e6, "1/MN"));
    }

    fn platform(&mut self) {
        let (priors, robot) = (self.priors, &self.set.robot);
        for (axis, at) in AXES.iter().zip(&robot.center_of_mass_m) {
            let name = format!("the centre of mass in {axis}");
            self.entered(name, priors.center_of_mass_m, MM, *at);
        }
        self.entered(
            "the mass".to_owned(),
            priors.mass,
            Unit::new(robot.mass_kg, "kg"),
            1.0,
        );
        let name = "the cables' compliance".to_owned();
        self.free(name, priors.compliance_per_n, Unit::new(1e6, "1/MN"));
        for axis in AXES {
            let name = format!("the inclinometer's mounting about {axis}");
            self.free(name, priors.mount_rad, DEGREES);
        }
    }

    /// A place of which nothing is known before.
    fn place(&mut self, what: &str) {
        for axis in AXES {
            self.free(format!("{what} in {axis}"), f64::INFINITY, MM);
        }
        for axis in AXES {
            self.free(format!("{what} about {axis}"), f64::INFINITY, DEGREES);
        }
    }

    fn eye(&mut self, eye: &Eye, bodies: usize) {
        let priors = self.priors;
        self.place("the camera's place");
        let focal = Unit::new(eye.camera.focal_px[0], "px");
        self.entered("the focal length".to_owned(), priors.focal, focal, 1.0);
        for (axis, at) in ["u", "v"].iter().zip(eye.camera.center_px) {
            let name = format!("the principal point in {axis}");
            self.entered(name, priors.center_px, Unit::new(1.0, "px"), at);
        }
        let k1 = eye.camera.distortion[0];
        self.entered(
            "the lens's k1".to_owned(),
            priors.k1,
            Unit::new(1.0, ""),
            k1,
        );
        let size = eye.tags.first().map_or(1.0, |tag| tag.size_m * 1e3);
        let name = "the tags' size".to_owned();
        self.entered(name, priors.tag, Unit::new(size, "mm"), 1.0);
        for body in 0..bodies {
            self.place(&format!("tag body {}", body + 1));
        }
    }

    fn tracker(&mut self, index: usize) {
        let Some(tracker) = self.set.trackers.get(index) else {
            return;
        };
        let name = &tracker.name;
        self.place(&format!("the frame of tracker {name}"));
        let of = format!("the target of tracker {name}");
        for (k, axis) in AXES.iter().enumerate() {
            let name = format!("{of} in {axis}");
            match tracker.target_m {
                Some(target) => self.entered(name, tracker.tolerance_m, MM, target[k]),
                None => self.free(name, UNKNOWN_TARGET_M, MM),
            }
        }
        let turns = (self.set.samples.iter()).any(|s| matches!(s.turned.get(index), Some(Some(_))));
        // Without attitudes there are no rows that would determine it.
        let sigma = if turns { f64::INFINITY } else { 1e-9 };
        for axis in AXES {
            self.free(format!("{of} about {axis}"), sigma, DEGREES);
        }
    }

    /// With one session alone its own part cannot be separated from the common one.
    fn session(&mut self, session: usize) {
        let (priors, set, cables) = (self.priors, self.set, self.layout.cables);
        let name = &set.sessions[session];
        let of = |what: &str, i: usize| format!("cable {}'s {what} in {name}", i + 1);
        for i in 0..cables {
            self.free(of("cell zero", i), priors.zero_session_n, N);
        }
        let homing = if set.robot.absolute && set.homed[session] {
            priors.homing_m
        } else {
            priors.change_m
        };
        for i in 0..cables {
            self.free(of("length offset", i), homing, MM);
        }
        for i in 0..cables {
            self.free(of("swivel offset", i), priors.swivel_session_rad, DEGREES);
        }
        for axis in ["x", "y"] {
            let what = format!("the inclinometer's mounting about {axis} in {name}");
            self.free(what, priors.mount_session_rad, DEGREES);
        }
        let yaw = format!("the yaw's zero in {name}");
        self.free(yaw, priors.yaw_rad, DEGREES);
        let drift = Unit::new(DEGREES.factor * 60.0, "deg/min");
        let what = format!("the yaw's drift in {name}");
        self.free(what, priors.yaw_rate_rps, drift);
    }
}
