//! How the platform swings about its path: natural modes that the plan's acceleration excites.
//!
//! At each point of a tube the platform is a body on springs: its mass matrix, and its stiffness by the cables' tensions and
//! elasticity. Drums of length-held cables move as planned; those of tension-held ones give way to an error of tension as their
//! law says. The inertia force of the planned acceleration moves the body off its path. What this force explains while it lasts
//! is known. Of the rest the amplitude in each natural mode counts: the phase is lost within some periods, since frequencies
//! are known to some percent only.

use super::doubts::Doubts;
use crate::estimate::region::tool_per_pose;
use crate::motion::{Model, PlanError, StaticState};
use crate::robot::TensionOutput;
use mcdpr_kinematics::Pose;
use nalgebra::{Matrix3, Matrix6, SymmetricEigen, Vector3, Vector6};

/// How a tool swings at a time.
#[derive(Debug, Default)]
pub(super) struct Swung {
    /// How far the present acceleration holds it back, m: that is no matter of phase.
    pub(super) off_m: Vector3<f64>,
    /// Covariance of the rest, m2.
    pub(super) covariance: Matrix3<f64>,
}

/// A platform on its way.
pub(super) struct Swing {
    doubts: Doubts,
    /// Covariance of what was there before, now: shift (m) and turn (rad), world, about the platform's origin.
    before: Matrix6<f64>,
    /// The same of the plan's own swing: of its modes, whose phases are lost.
    own: Matrix6<f64>,
    /// The same of the plan's own swing now: its modes give way together while the platform accelerates.
    now: Matrix6<f64>,
    /// What the present acceleration explains of how far the platform is off its path (m, rad).
    held_back: Vector6<f64>,
    /// How far the platform is off its path, and how fast it leaves it (m, rad; per s).
    off: Vector6<f64>,
    leaves: Vector6<f64>,
    /// The last point: time, s, planned pose, and the planned speed that led to it (m/s, rad/s).
    last: Option<(f64, Pose, Vector6<f64>)>,
}

impl Swing {
    pub(super) fn new(doubts: Doubts, before: &Matrix6<f64>) -> Self {
        Self {
            doubts,
            before: *before,
            own: Matrix6::zeros(),
            now: Matrix6::zeros(),
            held_back: Vector6::zeros(),
            off: Vector6::zeros(),
            leaves: Vector6::zeros(),
            last: None,
        }
    }

    /// Goes on to a point of the plan: how the tool swings there. `None` where the platform has no modes.
    ///
    /// # Errors
    /// A pose without geometry.
    pub(super) fn at(
        &mut self,
        model: &Model,
        rest: &StaticState,
        time_s: f64,
    ) -> Result<Option<Swung>, PlanError> {
        let pose = rest.equilibrium.pose;
        let speed = match &self.last {
            // Rounding of poses that are nearly at the same time would count as speed.
            Some((last_s, ..)) if time_s - last_s < LEAST_S => {
                return Ok(Some(self.tool(model, &pose)));
            }
            Some((last_s, last, before)) => {
                let step_s = time_s - last_s;
                let speed = moved(last, &pose) / step_s;
                let Some(body) = Body::of(model, rest)? else {
                    return Ok(None);
                };
                let acceleration = (speed - before) / step_s;
                self.go_on(&body, &acceleration, step_s);
                speed
            }
            None => Vector6::zeros(),
        };
        self.last = Some((time_s, pose, speed));
        Ok(Some(self.tool(model, &pose)))
    }

    /// The tool's swing with the platform at this pose.
    fn tool(&self, model: &Model, pose: &Pose) -> Swung {
        let arm = pose.rotation * model.robot().tool.tcp_in_platform_m;
        let tool = tool_per_pose(&arm);
        Swung {
            off_m: tool * self.held_back,
            covariance: tool * (self.before + self.now) * tool.transpose(),
        }
    }

    /// Covariance of the platform's swing now: shift (m) and turn (rad), world.
    pub(super) fn left(&self) -> Matrix6<f64> {
        self.before + self.own
    }

    fn go_on(&mut self, body: &Body, acceleration: &Vector6<f64>, step_s: f64) {
        let keep = libm::exp(-step_s / self.doubts.swing_s);
        self.before *= keep * keep;
        let Some((off, leaves)) = body.moved_on(&self.off, &self.leaves, acceleration, step_s)
        else {
            return;
        };
        (self.off, self.leaves) = (off * keep, leaves * keep);
        let share = self.doubts.swing.powi(2);
        self.own = Matrix6::zeros();
        self.now = Matrix6::zeros();
        self.held_back = Vector6::zeros();
        let at_rest = body.given_way(acceleration).unwrap_or_default();
        for (square, shape) in body.squares.iter().zip(body.shapes.column_iter()) {
            let by_mass = body.mass * shape;
            let (out, speed) = (by_mass.dot(&self.off), by_mass.dot(&self.leaves));
            let turned = shape * shape.transpose() * (speed * speed / square * share);
            self.own += turned + shape * shape.transpose() * (out * out * share);
            self.now += turned;
            // In a mode that is slower than the acceleration lasts the platform has not gone so far yet, and
            // after it nothing is explained.
            let explained = by_mass.dot(&at_rest);
            let (least, most) = (out.min(0.0), out.max(0.0));
            self.held_back += shape * explained.clamp(least, most);
        }
        let rest = self.off - self.held_back;
        self.now += rest * rest.transpose() * share;
    }
}

/// Shift (m) and turn (rad), world, from one pose to the next.
fn moved(from: &Pose, to: &Pose) -> Vector6<f64> {
    let shift = to.position_m - from.position_m;
    let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
    Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}

/// The platform on its cables at one place, as it moves about its path.
struct Body {
    mass: Matrix6<f64>,
    /// Mass that moves with it: the platform's, and drums of cables whose current is commanded.
    moving: Matrix6<f64>,
    /// Drums whose speed is commanded give way in proportion to the error of tension: a damper.
    damping: Matrix6<f64>,
    stiffness: Matrix6<f64>,
    /// Natural modes with all drums held: angular frequencies squared, 1/s2.
    squares: Vec<f64>,
    /// Their shapes in columns, of modal mass 1.
    shapes: nalgebra::Matrix6xX<f64>,
}

impl Body {
    /// `None` for a platform without mass.
    fn of(model: &Model, rest: &StaticState) -> Result<Option<Self>, PlanError> {
        let (robot, geometry) = (model.robot(), model.geometry());
        let stability = geometry.stability(&rest.equilibrium)?;
        let Some(mass) = stability.mass else {
            return Ok(None);
        };
        let (mut moving, mut damping) = (mass, Matrix6::zeros());
        let mut stiffness = stability.stiffness;
        let mut held = stiffness;
        let law = &robot.tension;
        let pose = &rest.equilibrium.pose;
        for (i, path) in geometry.paths(pose)?.iter().enumerate() {
            let parts = robot.cables.get(i).zip(rest.paid_out_m.get(i));
            let Some(((cable, paid_out_m), winch)) = parts.zip(robot.winch_of(i)) else {
                continue;
            };
            let turn = (path.attachment_m - pose.position_m).cross(&path.direction);
            let d = path.direction;
            let row = Vector6::new(d.x, d.y, d.z, turn.x, turn.y, turn.z);
            let along = row * row.transpose();
            // A platform whose attitude is planned rests on elastic cables: their stiffness is counted already.
            let counted = rest.equilibrium.axial_stiffness_n_per_m.get(i);
            if counted.is_some_and(|axial| *axial > 0.0) {
                continue;
            }
            let axial = cable.ea_n / (paid_out_m + cable.routing_length_m);
            held += along * axial;
            if model.holding().by_length().contains(&i) {
                stiffness += along * axial;
                continue;
            }
            match law.output {
                // Gains in mm/s per N.
                TensionOutput::Velocity => damping += along * (1e3 / law.kp.max(1e-3)),
                TensionOutput::Current => {
                    let share = 1.0 / (1.0 + law.kp.max(0.0));
                    moving += along * (winch.effective_mass_kg() * share);
                    damping += along * (law.damping_ns_per_m * share);
                }
            }
        }
        let Some(inverse) = mass.cholesky().and_then(|root| root.l().try_inverse()) else {
            return Ok(None);
        };
        let dynamic = inverse * held * inverse.transpose();
        let own = SymmetricEigen::new((dynamic + dynamic.transpose()) * 0.5);
        let shapes = inverse.transpose() * own.eigenvectors;
        let firm: Vec<usize> = (0..6).filter(|k| own.eigenvalues[*k] > SOFTEST).collect();
        Ok(Some(Self {
            mass,
            moving,
            damping,
            stiffness,
            squares: firm.iter().map(|k| own.eigenvalues[*k]).collect(),
            shapes: shapes.select_columns(&firm),
        }))
    }

    /// Where the platform rests under the inertia force of an acceleration that lasts: shift (m) and turn (rad), world.
    fn given_way(&self, acceleration: &Vector6<f64>) -> Option<Vector6<f64>> {
        self.stiffness.lu().solve(&-(self.mass * acceleration))
    }

    /// Displacement and its rate after a step under the inertia force of a planned acceleration: Newmark's method with constant
    /// mean acceleration (1959), which is stable at any step.
    fn moved_on(
        &self,
        off: &Vector6<f64>,
        leaves: &Vector6<f64>,
        acceleration: &Vector6<f64>,
        step_s: f64,
    ) -> Option<(Vector6<f64>, Vector6<f64>)> {
        // The mean of both ends: M (v' - v) / h + C (v + v') / 2 + K (x + x') / 2 = f, x' = x + h (v + v') / 2.
        let force = -(self.mass * acceleration);
        let matrix = self.moving / step_s + self.damping * 0.5 + self.stiffness * (0.25 * step_s);
        let right = force + self.moving * leaves / step_s
            - self.damping * leaves * 0.5
            - self.stiffness * (off + leaves * (0.25 * step_s));
        let next = matrix.lu().solve(&right)?;
        Some((off + (leaves + next) * (0.5 * step_s), next))
    }
}

/// A mode below this square of an angular frequency has no stiffness, 1/s2: a period of 60 s.
const SOFTEST: f64 = 0.01;
/// Shorter steps are left out, s.
const LEAST_S: f64 = 2e-3;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;

    #[test]
    fn a_platform_that_accelerates_gives_way_by_its_length_held_cables_each_counted_once() {
        let model = Model::new(&Robot::built_in("eight-cable").unwrap()).unwrap();
        let rest = model.rest_at_home().unwrap();
        let body = Body::of(&model, &rest).unwrap().unwrap();
        // Hooke's law, cable by cable.
        let mut stiffness = Matrix6::zeros();
        let pose = rest.equilibrium.pose;
        let paths = model.geometry().paths(&pose).unwrap();
        for &i in model.holding().by_length() {
            let path = &paths[i];
            let arm = path.attachment_m - pose.position_m;
            let turn = arm.cross(&path.direction);
            let d = path.direction;
            let row = Vector6::new(d.x, d.y, d.z, turn.x, turn.y, turn.z);
            let cable = &model.robot().cables[i];
            stiffness += row
                * row.transpose()
                * (cable.ea_n / (rest.paid_out_m[i] + cable.routing_length_m));
        }
        let acceleration = Vector6::new(1.0, 0.0, 0.5, 0.0, 0.0, 0.0);
        let by_hand = stiffness.try_inverse().unwrap() * -(body.mass * acceleration);
        let (mut off, mut leaves) = (Vector6::zeros(), Vector6::zeros());
        // Half a minute with a damper of its own, since nothing else stops a swing.
        for _ in 0..3000 {
            (off, leaves) = body.moved_on(&off, &leaves, &acceleration, 0.01).unwrap();
            leaves *= 0.9;
        }
        assert!((body.given_way(&acceleration).unwrap() - off).norm() < 1e-9);
        let shift = |of: &Vector6<f64>| Vector3::new(of[0], of[1], of[2]);
        let wrong = (shift(&off) - shift(&by_hand)).norm() / shift(&by_hand).norm();
        // What the tensions add to the stiffness is a few percent.
        assert!(wrong < 0.08, "{off} in the tube, {by_hand} by hand");
    }

    #[test]
    fn an_acceleration_explains_where_the_platform_is_while_it_lasts_and_not_afterwards() {
        let model = Model::new(&Robot::built_in("eight-cable").unwrap()).unwrap();
        let rest = model.rest_at_home().unwrap();
        let body = Body::of(&model, &rest).unwrap().unwrap();
        let mut swing = Swing::new(Doubts::within(0.0), &Matrix6::zeros());
        let full = Vector6::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        // It grows within a second: too slowly for a swing.
        for step in 1..=100 {
            swing.go_on(&body, &(full * f64::from(step) * 0.01), 0.01);
        }
        let known = body.given_way(&full).unwrap();
        let off = (swing.held_back - known).norm() / known.norm();
        assert!(off < 0.1, "{} {known}", swing.held_back);
        // What is left over is little, and counted in full while its phase is lost.
        assert!(swing.now.trace() < 0.05 * known.norm_squared());
        swing.go_on(&body, &Vector6::zeros(), 0.01);
        assert_eq!(swing.held_back, Vector6::zeros());
        assert!(swing.own.trace() > 0.05 * known.norm_squared());
    }
}
