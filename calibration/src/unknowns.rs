//! The unknowns of the joint estimate: their values, their order in the vectors, their priors.

use super::data::Data;
use mcdpr_kinematics::{Cable, Pose};
use mcdpr_vision::Camera;
use nalgebra::Vector3;

/// Index of each unknown. Core unknowns come first: anchors, initial lengths, camera, bodies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Number of cables.
    pub cables: usize,
    /// Number of rigid bodies of tags.
    pub bodies: usize,
    /// Whether tensions and the equations of equilibrium take part.
    pub statics: bool,
    /// Whether an inclinometer on the platform takes part.
    pub tilt: bool,
}

impl Layout {
    /// First coordinate of a cable's anchor.
    #[must_use]
    pub fn anchor(&self, cable: usize) -> usize {
        3 * cable
    }
    /// A cable's initial length.
    #[must_use]
    pub fn initial_length(&self, cable: usize) -> usize {
        3 * self.cables + cable
    }
    /// Order of the unknowns in a calibrated robot's covariance; `None` without one.
    pub(crate) fn of(robot: &mcdpr_core::robot::Robot) -> Option<Self> {
        let calibrated = robot.calibrated.as_ref()?;
        let rows = calibrated.covariance.as_ref()?.nrows();
        // Data without tensions or tilt give a calibration without those unknowns.
        let kinds = [(true, false), (false, false), (true, true), (false, true)];
        let layouts = kinds.map(|(statics, tilt)| Self {
            cables: robot.cables.len(),
            bodies: calibrated.places.len(),
            statics,
            tilt,
        });
        layouts.into_iter().find(|layout| layout.len() == rows)
    }
    /// First of the six coordinates of camera_from_platform.
    #[must_use]
    pub fn camera(&self) -> usize {
        4 * self.cables
    }
    /// First of the six coordinates of a body.
    #[must_use]
    pub fn body(&self, body: usize) -> usize {
        4 * self.cables + 6 + 6 * body
    }
    /// Number of core unknowns.
    #[must_use]
    pub fn core(&self) -> usize {
        self.body(self.bodies)
    }
    /// A cable's pulley radius.
    #[must_use]
    pub fn radius(&self, cable: usize) -> usize {
        self.core() + cable
    }
    /// First coordinate of a cable's attachment.
    #[must_use]
    pub fn attachment(&self, cable: usize) -> usize {
        self.core() + self.cables + 3 * cable
    }
    /// First of drum scale, focal scale, cx, cy, k1, tag scale.
    #[must_use]
    pub fn scales(&self) -> usize {
        self.core() + 4 * self.cables
    }
    /// A drum's own scale beyond the common one.
    #[must_use]
    pub fn drum(&self, cable: usize) -> usize {
        self.scales() + 6 + cable
    }
    /// First of compliance (1/EA), mass, centre of mass (3).
    #[must_use]
    pub fn statics(&self) -> usize {
        self.drum(self.cables)
    }
    /// A cable's loss of tension between winch and platform.
    #[must_use]
    pub fn loss(&self, cable: usize) -> usize {
        self.statics() + 5 + cable
    }
    /// Zero of a cable's tension sensor, N.
    #[must_use]
    pub fn zero(&self, cable: usize) -> usize {
        self.loss(self.cables) + cable
    }
    /// A cable's own compliance beyond the common one, 1/N.
    #[must_use]
    pub fn soft(&self, cable: usize) -> usize {
        self.zero(self.cables) + cable
    }
    /// First of three: how the inclinometer is turned on the platform.
    #[must_use]
    pub fn mount(&self) -> usize {
        if self.statics {
            self.soft(self.cables)
        } else {
            self.statics()
        }
    }
    /// Number of unknowns shared by all poses.
    #[must_use]
    pub fn len(&self) -> usize {
        self.mount() + if self.tilt { 3 } else { 0 }
    }
    /// Never true: a robot has cables.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// Number of unknowns of one pose: its displacement, and the cables' tensions.
    #[must_use]
    pub fn local(&self) -> usize {
        if self.statics { 6 + self.cables } else { 6 }
    }
}

/// Values of all unknowns.
#[derive(Debug, Clone)]
pub struct State {
    /// Anchor, pulley radius and attachment of each cable (the axis is given).
    pub cables: Vec<Cable>,
    /// Length of each cable when its encoder reads zero, m.
    pub initial_length_m: Vec<f64>,
    /// Cable between each drum and its anchor, m: given, not estimated.
    pub routing_m: Vec<f64>,
    /// camera_from_platform.
    pub camera_from_platform: Pose,
    /// world_from_body.
    pub world_from_body: Vec<Pose>,
    /// True length per length that the encoder reports.
    pub drum_scale: f64,
    /// The same of each drum beyond the common value.
    pub drum_own: Vec<f64>,
    /// The camera with its present intrinsics.
    pub camera: Camera,
    /// Common relative change of the focal lengths from nominal.
    pub focal_scale: f64,
    /// True size of the tags per stated size.
    pub tag_scale: f64,
    /// 1/EA, 1/N: relative stretch per tension.
    pub compliance_per_n: f64,
    /// The same of each cable beyond the common value, 1/N.
    pub soft_per_n: Vec<f64>,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass, platform frame, m.
    pub center_of_mass_m: Vector3<f64>,
    /// Share of each winch's tension that does not reach the platform.
    pub loss: Vec<f64>,
    /// What each tension sensor reads without tension, N.
    pub zero_n: Vec<f64>,
    /// How the inclinometer is turned on the platform: rotation vector of platform_from_sensor, rad.
    pub mount_rad: Vector3<f64>,
    /// world_from_platform of each pose.
    pub poses: Vec<Pose>,
    /// Tension of each cable at the platform, N, per pose.
    pub tensions_n: Vec<Vec<f64>>,
}

/// Priors: standard deviations about nominal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Priors {
    /// Pulley radius, m.
    pub radius_m: f64,
    /// Each coordinate of an attachment, m.
    pub attachment_m: f64,
    /// Common drum scale, relative.
    pub drum: f64,
    /// Each drum's own scale, relative. Where the data show more than this, the estimate widens it.
    pub drum_own: f64,
    /// Focal length, relative.
    pub focal: f64,
    /// Principal point, px.
    pub center_px: f64,
    /// k1.
    pub k1: f64,
    /// Tag size, relative.
    pub tag: f64,
    /// 1/EA about the specified value, relative.
    pub compliance: f64,
    /// 1/EA about zero if not specified, 1/N.
    pub compliance_per_n: f64,
    /// Mass, relative.
    pub mass: f64,
    /// Each coordinate of the centre of mass, m.
    pub center_of_mass_m: f64,
    /// Mean loss of tension per cable about zero, relative.
    pub loss: f64,
    /// Zero of each tension sensor, N. Widened like [`Self::drum_own`].
    pub zero_n: f64,
    /// Each cable's own compliance, 1/N. Widened like [`Self::drum_own`].
    pub soft_per_n: f64,
    /// How the inclinometer is turned on the platform, about each axis, rad.
    pub mount_rad: f64,
}

impl Default for Priors {
    fn default() -> Self {
        Self {
            radius_m: 3e-5,
            attachment_m: 5e-5,
            drum: 5e-4,
            // Less than the encoders' noise over a metre: no effect on data of like drums.
            drum_own: 1e-5,
            focal: 1e-3,
            center_px: 1.0,
            k1: 5e-4,
            tag: 1e-3,
            compliance: 0.3,
            compliance_per_n: 1.5e-5,
            mass: 0.02,
            center_of_mass_m: 1e-3,
            loss: 0.005,
            zero_n: 0.01,
            soft_per_n: 1e-7,
            // 1.7 degrees: 1.6 were found on IRMA4U (University of Bologna).
            mount_rad: 0.03,
        }
    }
}

/// Parts of a machine whose priors the data may widen: machines differ more from each other than one
/// number can say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Part {
    /// Each drum's own scale.
    Drums,
    /// Each tension sensor's gain, with the loss at the pulleys.
    Gains,
    /// Each tension sensor's zero.
    Zeros,
    /// Each cable's own compliance.
    Cables,
    /// The centre of mass.
    Center,
    /// The cables' common compliance.
    Compliance,
    /// Each pulley's radius.
    Radii,
}

impl Part {
    pub(crate) const ALL: [Self; 7] = [
        Self::Drums,
        Self::Gains,
        Self::Zeros,
        Self::Cables,
        Self::Center,
        Self::Compliance,
        Self::Radii,
    ];

    /// Its unknowns.
    pub(crate) fn range(self, layout: &Layout) -> std::ops::Range<usize> {
        let each = |first: usize, count: usize| first..first + count;
        let n = layout.cables;
        match self {
            Self::Drums => each(layout.drum(0), n),
            Self::Radii => each(layout.radius(0), n),
            _ if !layout.statics => 0..0,
            Self::Gains => each(layout.loss(0), n),
            Self::Zeros => each(layout.zero(0), n),
            Self::Cables => each(layout.soft(0), n),
            Self::Center => each(layout.statics() + 2, 3),
            Self::Compliance => each(layout.statics(), 1),
        }
    }

    /// Multiplies its standard deviation.
    pub(crate) fn widen(self, priors: &mut Priors, by: f64) {
        match self {
            Self::Drums => priors.drum_own *= by,
            Self::Radii => priors.radius_m *= by,
            Self::Gains => priors.loss *= by,
            Self::Zeros => priors.zero_n *= by,
            Self::Cables => priors.soft_per_n *= by,
            Self::Center => priors.center_of_mass_m *= by,
            Self::Compliance => {
                priors.compliance *= by;
                priors.compliance_per_n *= by;
            }
        }
    }
}

/// One prior: index of the unknown, its difference from nominal, and its standard deviation.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Prior {
    /// Index into the shared unknowns.
    pub index: usize,
    /// Value minus nominal.
    pub deviation: f64,
    /// Standard deviation.
    pub sigma: f64,
}

impl State {
    /// True length per length that a cable's encoder reports.
    #[must_use]
    pub(crate) fn scale(&self, cable: usize) -> f64 {
        self.drum_scale + self.drum_own[cable]
    }

    /// A cable's compliance, 1/N.
    #[must_use]
    pub(crate) fn compliance(&self, cable: usize) -> f64 {
        self.compliance_per_n + self.soft_per_n[cable]
    }

    /// The priors at this state.
    #[must_use]
    pub(crate) fn priors(&self, data: &Data, layout: &Layout, priors: &Priors) -> Vec<Prior> {
        let mut out = Vec::with_capacity(layout.len());
        let mut add = |index, deviation, sigma| {
            out.push(Prior {
                index,
                deviation,
                sigma,
            });
        };
        // A uniform distribution of half width w has the standard deviation w/sqrt(3).
        let anchor = data.robot.anchor_half_tolerance_m / 3f64.sqrt();
        for (i, (now, nominal)) in self.cables.iter().zip(&data.robot.cables).enumerate() {
            for k in 0..3 {
                add(
                    layout.anchor(i) + k,
                    now.anchor_m[k] - nominal.anchor_m[k],
                    anchor,
                );
                add(
                    layout.attachment(i) + k,
                    now.attachment_m[k] - nominal.attachment_m[k],
                    priors.attachment_m,
                );
            }
            add(
                layout.radius(i),
                now.pulley_radius_m - nominal.pulley_radius_m,
                priors.radius_m,
            );
        }
        let s = layout.scales();
        let (now, nominal) = (&self.camera, &data.camera);
        add(s, self.drum_scale - 1.0, priors.drum);
        add(s + 1, self.focal_scale, priors.focal);
        for k in 0..2 {
            add(
                s + 2 + k,
                now.center_px[k] - nominal.center_px[k],
                priors.center_px,
            );
        }
        add(s + 4, now.distortion[0] - nominal.distortion[0], priors.k1);
        add(s + 5, self.tag_scale - 1.0, priors.tag);
        for (i, own) in self.drum_own.iter().enumerate() {
            add(layout.drum(i), *own, priors.drum_own);
        }
        if layout.statics {
            let s = layout.statics();
            let nominal = data.robot.compliance_per_n;
            // A specified stiffness is known to a share of it; without one the prior is a stiff
            // cable.
            let sigma = if nominal > 0.0 {
                priors.compliance * nominal
            } else {
                priors.compliance_per_n
            };
            add(s, self.compliance_per_n - nominal, sigma);
            let mass = data.robot.mass_kg;
            add(s + 1, self.mass_kg - mass, priors.mass * mass);
            let off = self.center_of_mass_m - data.robot.center_of_mass_m;
            for k in 0..3 {
                add(s + 2 + k, off[k], priors.center_of_mass_m);
            }
            for (i, loss) in self.loss.iter().enumerate() {
                add(layout.loss(i), *loss, priors.loss);
                add(layout.zero(i), self.zero_n[i], priors.zero_n);
                add(layout.soft(i), self.soft_per_n[i], priors.soft_per_n);
            }
        }
        if layout.tilt {
            for k in 0..3 {
                add(layout.mount() + k, self.mount_rad[k], priors.mount_rad);
            }
        }
        out
    }

    /// The state after a step of the shared unknowns and of each pose's own.
    #[must_use]
    pub fn stepped(&self, data: &Data, layout: &Layout, shared: &[f64], own: &[f64]) -> Self {
        let three = |s: &[f64], i: usize| Vector3::new(s[i], s[i + 1], s[i + 2]);
        let moved =
            |pose: &Pose, s: &[f64], i: usize| pose.displaced(&three(s, i), &three(s, i + 3));
        let mut out = self.clone();
        for (i, cable) in out.cables.iter_mut().enumerate() {
            cable.anchor_m += three(shared, layout.anchor(i));
            cable.attachment_m += three(shared, layout.attachment(i));
            // The radius of a point anchor is the minimum.
            cable.pulley_radius_m = (cable.pulley_radius_m + shared[layout.radius(i)]).max(0.0);
            out.initial_length_m[i] += shared[layout.initial_length(i)];
        }
        out.camera_from_platform = moved(&self.camera_from_platform, shared, layout.camera());
        for (i, body) in out.world_from_body.iter_mut().enumerate() {
            *body = moved(body, shared, layout.body(i));
        }
        let s = layout.scales();
        out.drum_scale += shared[s];
        out.focal_scale += shared[s + 1];
        for k in 0..2 {
            out.camera.focal_px[k] = data.camera.focal_px[k] * (1.0 + out.focal_scale);
            out.camera.center_px[k] += shared[s + 2 + k];
        }
        out.camera.distortion[0] += shared[s + 4];
        out.tag_scale += shared[s + 5];
        for (i, own) in out.drum_own.iter_mut().enumerate() {
            *own += shared[layout.drum(i)];
        }
        if layout.statics {
            let s = layout.statics();
            out.compliance_per_n += shared[s];
            out.mass_kg += shared[s + 1];
            out.center_of_mass_m += three(shared, s + 2);
            for (i, loss) in out.loss.iter_mut().enumerate() {
                *loss += shared[layout.loss(i)];
                out.zero_n[i] += shared[layout.zero(i)];
                out.soft_per_n[i] += shared[layout.soft(i)];
            }
        }
        if layout.tilt {
            out.mount_rad += three(shared, layout.mount());
        }
        for (k, own) in own.chunks_exact(layout.local()).enumerate() {
            out.poses[k] = moved(&self.poses[k], own, 0);
            if layout.statics {
                for (tension, step) in out.tensions_n[k].iter_mut().zip(&own[6..]) {
                    *tension += step;
                }
            }
        }
        out
    }
}
