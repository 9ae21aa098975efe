//! Model of the drums between the cut of their supply and closed brakes.
//!
//! Until its brake grips, a drum without torque continues at its speed and pays out cable: the
//! platform falls against the rotors' inertia and friction. With the drums' masses at the cable M_i,
//! friction f_i and the lengths' slopes A_i by the tool's place (d l_i = A_i dx), d'Alembert's principle
//! gives the tool's acceleration a from `(m 1 + sum M_i A_i A_i^T) a = m g - sum f_i A_i`, the platform
//! taken for a point mass; drum i pays out with `A_i a`. Then the brake stops it over
//! `v^2 M / (2 (F - T))`. Uncertainties of brakes and drives enter the covariance.
//!
//! A drive that keeps its supply continues until the contactor has opened, which the lost board lets go: for
//! the drive's lag if its cable is held by length. One that is held by tension has a drive with a constant current:
//! its drum moves on against the cable's stiffness k, by `v / w sin(w t)` with `w^2 = k / M`.

use crate::motion::{Model, StaticState};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix4, Vector3};

use super::journal::Kept;
use crate::robot::Winch;

/// A brake's closing time over that of the robot file: mean and standard deviation. Assumption:
/// data sheets of spring-applied brakes give nominal times, which rise with wear of the air gap and with
/// the kind of switching, and fall with temperature.
const BRAKE_TIME: [f64; 2] = [1.05, 0.17];
/// Friction of a closing brake at the cable, N, and its relative standard deviation; assumption.
const BRAKE_N: f64 = 120.0;
const BRAKE_SPREAD: f64 = 0.5;
/// Relative standard deviation of the acceleration: friction, inertia, the point mass.
const ACCELERATION_SPREAD: f64 = 0.2;
/// Relative standard deviation of the way in a drive's lag, and of a drum under constant current: brake
/// time, stiffness and friction. The second was chosen on seeds 40001 to 40540 of lab-fast.
const LAG_SPREAD: f64 = 0.5;
const CURRENT_SPREAD: f64 = 0.2;
/// Standard deviation of the acceleration in the time that no record covers, per axis, as a share of the
/// robot's limit, and the time in which drums stop afterwards, s. Chosen on the same seeds as [`KNOWN_M`]; a
/// share of 0.5 stated too much. With no such term, seed 40392 of lab-fast was 2.0 mm off with 0.7 mm stated: its
/// motion began after the last record.
const UNSEEN_SHARE: f64 = 0.28;
const HELD_S: f64 = 0.015;
/// A drum slower than this is at rest, m/s: the steps of its encoder look like this speed.
const STANDS_MPS: f64 = 5e-4;
/// A tick, after which the lengths are kept, and the time from a fault to running counters, s: the handler, the reset's
/// pulse (20 us at least; RM0008, 7.1) and some 40 instructions at 8 MHz.
const UNCOUNTED_S: f64 = 1e-3 + 5e-5;
/// Time for which drives continue after their board was lost, until their contactor has opened, and its standard
/// deviation; common to all drums. A contactor takes 16 to 24 ms (Schneider Electric, TeSys D, LC1D09BD), uniform: 20 and
/// 2.3 ms. But the drum with the slowest brake goes on alone, which the model does not have: with those values the tool
/// fell 0.33 mm further than expected (`lab-fast`, eight machines), and the statistical bound held in 90 and 92 % of 60
/// cases each (docs/results/power.md). With these it holds in 97 and 93 %.
const CONTACTOR_S: f64 = 0.0175;
const CONTACTOR_SD_S: f64 = 0.006;
/// Step of the slopes, m.
const STEP_M: f64 = 1e-4;
const STEP_N: f64 = 0.05;
const GRAVITY_MPS2: f64 = 9.80665;

/// Time and kind of the cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cut {
    /// Time from the last state in the journal to the cut: mean, s.
    pub unseen_s: f64,
    /// Its standard deviation, s.
    pub unseen_sd_s: f64,
    /// Probability that the drives lost their supply, too.
    pub torque_gone: f64,
}

/// Lengths with their covariance.
#[derive(Debug, Clone, PartialEq)]
pub struct Lengths {
    /// Paid-out lengths, m.
    pub mean_m: DVector<f64>,
    /// Their covariance, m².
    pub covariance_m2: DMatrix<f64>,
}

/// Standard deviation of a counted length, m, without the error of the place of homing: anchors and
/// attachments after a calibration, and what pulleys, centre of mass and elasticity change in the platform's
/// attitude. Chosen on seeds 30001 to 30600 of lab-fast and paper-optimistic, so that 95 % of the errors without a
/// camera are within the statistical bound; 0.175 mm gave 100 %, 0.12 mm 88 %.
pub(crate) const KNOWN_M: f64 = 1.35e-4;

impl Lengths {
    /// Lengths of a board that kept its supply.
    #[must_use]
    pub fn counted(lengths_m: &[f64]) -> Self {
        let count = lengths_m.len();
        Self {
            mean_m: DVector::from_column_slice(lengths_m),
            covariance_m2: DMatrix::identity(count, count) * KNOWN_M.powi(2),
        }
    }

    /// Lengths of a board that was reset at these speeds (mean and standard deviation, m/s), and counted on: of its
    /// last millisecond the part between tick and reset is not counted, uniform. Its mean is added.
    #[must_use]
    pub fn counted_on(lengths_m: &[f64], speeds_mps: &[[f64; 2]]) -> Self {
        let mut lengths = Self::counted(lengths_m);
        for (cable, [mean_mps, sd_mps]) in speeds_mps.iter().enumerate().take(lengths_m.len()) {
            lengths.mean_m[cable] += mean_mps * UNCOUNTED_S / 2.0;
            // A product of two independent values: time of mean T/2 and variance T²/12, and the speed.
            let variance = mean_mps.powi(2) / 12.0 + sd_mps.powi(2) / 3.0;
            lengths.covariance_m2[(cable, cable)] += variance * UNCOUNTED_S.powi(2);
        }
        lengths
    }

    /// Standard deviation of one length, m.
    #[must_use]
    pub fn sigma_m(&self, cable: usize) -> f64 {
        self.covariance_m2
            .get((cable, cable))
            .map_or(f64::INFINITY, |variance| variance.sqrt())
    }
}

/// Slopes of the lengths by the tool's place, one row a cable; `None` where the robot cannot hang
/// beside `rest`.
fn slopes(model: &Model, rest: &StaticState) -> Option<DMatrix<f64>> {
    let tool_m = model.tool_m(rest);
    let count = rest.paid_out_m.len();
    let held = model.holding().first_by_tension().unwrap_or(0);
    let tension_n = rest.tensions_n().get(held).copied()?;
    let mut slopes = DMatrix::zeros(count, 3);
    for axis in 0..3 {
        let mut near_m = tool_m;
        near_m[axis] += STEP_M;
        let near = model.rest_with(&near_m, tension_n, Some(rest)).ok()?;
        let pairs = near
            .equilibrium
            .lengths_m
            .iter()
            .zip(&rest.equilibrium.lengths_m);
        for (cable, (there, here)) in pairs.enumerate() {
            slopes[(cable, axis)] = (there - here) / STEP_M;
        }
    }
    Some(slopes)
}

/// Lengths after a cut, from the last state in the journal; `rest` is the robot's statics then.
#[must_use]
pub(crate) fn lengths_after(model: &Model, rest: &StaticState, kept: &Kept, cut: &Cut) -> Lengths {
    let lengths_m: Vec<f64> = kept.cables.iter().map(|cable| cable.length_m).collect();
    let mut lengths = Lengths::counted(&lengths_m);
    let open = |cable: usize| kept.brakes_open >> cable & 1 == 1;
    // Closed brakes held through the cut: the counts are as good as before.
    if kept.brakes_open == 0 {
        return lengths;
    }
    let count = kept.cables.len();
    let falls = paying_out(model, rest, kept);
    let stiffness = stiffness_n_per_m(model, rest);
    let mut coasts = DVector::zeros(count);
    // With the drives' supply gone, and with it kept.
    let (mut free, mut held, mut grows) = (coasts.clone(), coasts.clone(), coasts.clone());
    // Speeds at which the brakes grip.
    let mut grips = coasts.clone();
    let gone = cut.torque_gone.clamp(0.0, 1.0);
    for (cable, state) in kept
        .cables
        .iter()
        .enumerate()
        .filter(|(cable, _)| open(*cable))
    {
        let Some(winch) = model.robot().winch_of(cable) else {
            continue;
        };
        let moves = state.speed_mps.abs() > STANDS_MPS;
        let kept_mps = if moves { state.speed_mps } else { 0.0 };
        let out_mps2 = falls.get(cable).copied().unwrap_or(0.0);
        let by_tension = model.holding().by_tension().contains(&cable);
        let drum = Drum {
            winch,
            speed_mps: kept_mps,
            out_mps2,
            tension_n: state.tension_n,
            stiffness_n_per_m: by_tension.then_some(stiffness),
        };
        // A board that is lost lets the contactor of its drives open, however long their rail holds up.
        let without = drum.until_braked(winch.drive_hold_up_s.min(CONTACTOR_S));
        let with = drum.until_braked(CONTACTOR_S);
        free[cable] = without.way_m;
        held[cable] = with.way_m;
        coasts[cable] = kept_mps;
        let mixed = |gone_m: f64, kept_m: f64| gone * gone_m + (1.0 - gone) * kept_m;
        grows[cable] = mixed(without.fallen_m, with.fallen_m) * ACCELERATION_SPREAD;
        // With the supply gone, a rail that ends sooner decides, not the contactor.
        let waits = winch.drive_hold_up_s >= CONTACTOR_S;
        grips[cable] = mixed(if waits { without.grip_mps } else { 0.0 }, with.grip_mps);
        lengths.covariance_m2[(cable, cable)] += mixed(without.variance_m2, with.variance_m2);
    }
    let differ = &free - &held;
    lengths.mean_m += &coasts * cut.unseen_s + &held + &differ * gone;
    // Time and cause of the cut are common to all drums: their errors are fully correlated. The
    // cause is yes or no: variance p (1 - p).
    lengths.covariance_m2 += &coasts * coasts.transpose() * cut.unseen_sd_s.powi(2);
    lengths.covariance_m2 += &differ * differ.transpose() * (gone * (1.0 - gone));
    lengths.covariance_m2 += &grows * grows.transpose();
    lengths.covariance_m2 += &grips * grips.transpose() * CONTACTOR_SD_S.powi(2);
    // A motion may have begun, turned or ended after the last record: no record says which way.
    if let Some(slopes) = slopes(model, rest) {
        let mean_square_s2 = cut.unseen_s.powi(2) + cut.unseen_sd_s.powi(2);
        let way_s2 = 0.5 * mean_square_s2 + cut.unseen_s * HELD_S;
        let sigma_m = UNSEEN_SHARE * model.robot().limits.acceleration_mps2 * way_s2;
        lengths.covariance_m2 += &slopes * slopes.transpose() * sigma_m.powi(2);
    }
    lengths
}

/// A drum with its brake open when its board is lost.
struct Drum<'a> {
    winch: &'a Winch,
    speed_mps: f64,
    /// Acceleration without torque, m/s².
    out_mps2: f64,
    tension_n: f64,
    /// Of a cable that is held by tension: how its tension rises with the length that is taken in.
    stiffness_n_per_m: Option<f64>,
}

/// A drum's way until its brake holds.
struct Way {
    way_m: f64,
    /// The part of the fall.
    fallen_m: f64,
    /// Its speed when the brake grips.
    grip_mps: f64,
    /// Of times, friction and play of this drum alone.
    variance_m2: f64,
}

impl Drum<'_> {
    /// With a drive that continues for so long, s.
    fn until_braked(&self, drive_s: f64) -> Way {
        let winch = self.winch;
        let close_s = winch.brake_close_s * BRAKE_TIME[0];
        let (way_s, left) = self.without_commands(drive_s.min(close_s));
        let (stopping_m, speed_mps) = (self.speed_mps * way_s, self.speed_mps * left);
        let free = FreeTime::of(winch.brake_close_s, drive_s);
        let grip_mps = speed_mps + self.out_mps2 * free.mean_s;
        // The cable pulls against the brake. A fifth of its friction remains, so that the way stays
        // finite.
        let grip_n = (BRAKE_N - self.tension_n).max(0.2 * BRAKE_N);
        let stop_m = grip_mps * grip_mps.abs() * winch.effective_mass_kg() / (2.0 * grip_n);
        let fallen_m = 0.5 * self.out_mps2 * free.mean_square_s2;
        let play_m = winch.brake_play_m;
        let spread = match self.stiffness_n_per_m {
            Some(_) => CURRENT_SPREAD,
            None => LAG_SPREAD,
        };
        Way {
            // The drum may rest anywhere in the brake's play: uniform, so mean 1/2 and variance 1/12.
            way_m: stopping_m + speed_mps * free.mean_s + fallen_m + stop_m + 0.5 * play_m,
            fallen_m,
            grip_mps,
            variance_m2: (grip_mps * free.sd_s).powi(2)
                + (stop_m * BRAKE_SPREAD).powi(2)
                + play_m.powi(2) / 12.0
                + (spread * stopping_m).powi(2),
        }
    }

    /// Way per speed, s, and share of the speed that is left, so long after the last command.
    fn without_commands(&self, for_s: f64) -> (f64, f64) {
        if let Some(stiffness) = self.stiffness_n_per_m {
            let w = (stiffness / self.winch.effective_mass_kg())
                .sqrt()
                .max(1e-3);
            return (libm::sin(w * for_s) / w, libm::cos(w * for_s));
        }
        let bandwidth = self.winch.drive_bandwidth_rad_s;
        let left = libm::exp(-for_s * bandwidth);
        ((1.0 - left) / bandwidth, left)
    }
}

/// Stiffness of the cable held by tension while all other lengths stay, N/m: how much its tension rises per
/// metre that its drum takes in. Zero where it is unknown: for robots of other shapes.
fn stiffness_n_per_m(model: &Model, rest: &StaticState) -> f64 {
    let [cable] = *model.holding().by_tension() else {
        return 0.0;
    };
    let (tool_m, tensions_n) = (model.tool_m(rest), rest.tensions_n());
    let Some(tension_n) = tensions_n.get(cable).copied() else {
        return 0.0;
    };
    if tensions_n.len() != 4 {
        return 0.0;
    }
    let mut slopes = Matrix4::zeros();
    for column in 0..4 {
        let (mut near_m, mut near_n) = (tool_m, tension_n);
        let step = if column < 3 { STEP_M } else { STEP_N };
        match near_m.get_mut(column) {
            Some(axis) => *axis += step,
            None => near_n += step,
        }
        let Ok(near) = model.rest_with(&near_m, near_n, Some(rest)) else {
            return 0.0;
        };
        for (row, (there, here)) in near.paid_out_m.iter().zip(&rest.paid_out_m).enumerate() {
            slopes[(row, column)] = (there - here) / step;
        }
    }
    // The last row: change of that tension per metre of each cable.
    let inverse = slopes.try_inverse();
    inverse.map_or(0.0, |inverse| (-inverse[(3, cable)]).max(0.0))
}

/// The time for which a drum is held by nothing: its brake's closing time without the time for which the
/// drive's rail holds up. Where the rail lasts longer, it is zero.
#[derive(Debug, Clone, Copy, PartialEq)]
struct FreeTime {
    mean_s: f64,
    sd_s: f64,
    mean_square_s2: f64,
}

impl FreeTime {
    /// Moments of the positive part of a normal variable (Greene, Econometric Analysis, section 19.2:
    /// truncated and censored distributions).
    fn of(close_s: f64, hold_up_s: f64) -> Self {
        let (mean_s, sd_s) = (close_s * BRAKE_TIME[0] - hold_up_s, close_s * BRAKE_TIME[1]);
        let ratio = mean_s / sd_s.max(1e-9);
        let below = 0.5 * libm::erfc(ratio / core::f64::consts::SQRT_2);
        let density = libm::exp(-0.5 * ratio * ratio) / (2.0 * core::f64::consts::PI).sqrt();
        let positive_s = (mean_s * (1.0 - below) + sd_s * density).max(0.0);
        let mean_square_s2 =
            ((mean_s * mean_s + sd_s * sd_s) * (1.0 - below) + mean_s * sd_s * density).max(0.0);
        Self {
            mean_s: positive_s,
            sd_s: (mean_square_s2 - positive_s * positive_s).max(0.0).sqrt(),
            mean_square_s2,
        }
    }
}

/// Acceleration of each drum without torque and with its brake open, m/s².
fn paying_out(model: &Model, rest: &StaticState, kept: &Kept) -> Vec<f64> {
    let robot = model.robot();
    let Some(slopes) = slopes(model, rest) else {
        return vec![0.0; kept.cables.len()];
    };
    let mut mass = Matrix3::identity() * robot.platform.mass_kg;
    let mut force = Vector3::new(0.0, 0.0, -GRAVITY_MPS2 * robot.platform.mass_kg);
    let drums = (0..kept.cables.len()).map(|cable| {
        let winch = robot.winch_of(cable)?;
        let row = Vector3::new(slopes[(cable, 0)], slopes[(cable, 1)], slopes[(cable, 2)]);
        Some((row, winch.effective_mass_kg(), winch.total_friction_n()))
    });
    let drums: Vec<_> = drums.collect();
    for (row, drum_kg, friction_n) in drums.iter().flatten() {
        mass += *drum_kg * row * row.transpose();
        force -= *friction_n * row;
    }
    let falls = mass
        .try_inverse()
        .map_or(Vector3::zeros(), |inverse| inverse * force);
    let pairs = drums.iter().zip(&kept.cables);
    pairs
        .map(|(drum, cable)| {
            let Some((row, drum_kg, friction_n)) = drum else {
                return 0.0;
            };
            // A drum accelerates no faster than its own cable's tension moves it, and friction over that
            // tension holds it.
            let most = ((cable.tension_n - friction_n) / drum_kg).max(0.0);
            row.dot(&falls).clamp(0.0, most)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::journal::KeptCable;
    use super::*;
    use crate::robot::Robot;

    /// A robot at home whose rails hold up for so long.
    fn hanging(robot: &str, hold_up_s: f64) -> (Model, StaticState, Kept) {
        let mut robot = Robot::built_in(robot).unwrap();
        for winch in &mut robot.winches {
            winch.drive_hold_up_s = hold_up_s;
        }
        let model = Model::new(&robot).unwrap();
        let rest = model.rest_at_home().unwrap();
        let cables = rest.paid_out_m.iter().zip(rest.tensions_n());
        let cables = cables.map(|(length_m, tension_n)| KeptCable {
            length_m: *length_m,
            setpoint_m: *length_m,
            speed_mps: 0.0,
            tension_n: *tension_n,
        });
        let kept = Kept {
            brakes_open: 15,
            referenced: true,
            cables: cables.collect(),
            ..Kept::default()
        };
        (model, rest, kept)
    }

    const CUT: Cut = Cut {
        unseen_s: 0.0,
        unseen_sd_s: 0.0,
        torque_gone: 1.0,
    };

    #[test]
    fn closed_brakes_hold_and_with_open_ones_a_light_robot_falls_further() {
        let mut paid_out = Vec::new();
        for robot in ["paper-optimistic", "lab-fast"] {
            let (model, rest, mut kept) = hanging(robot, 0.0);
            let after = lengths_after(&model, &rest, &kept, &CUT);
            let out = (0..4).map(|i| after.mean_m[i] - kept.cables[i].length_m);
            paid_out.push(out.fold(0.0, f64::max));
            kept.brakes_open = 0;
            let closed = lengths_after(&model, &rest, &kept, &CUT);
            assert_eq!(closed.mean_m[2], kept.cables[2].length_m);
        }
        // 34 kg at the cable fall slowly, 1.8 kg do not; no drum falls faster than freely.
        let free_m = 0.5 * 9.81 * 0.0315_f64.powi(2);
        // The mean square of the time counts, not its mean: 0.201 mm where it was 0.196.
        assert!(paid_out[0] < 2.1e-4, "{paid_out:?}");
        assert!(paid_out[1] > 5e-4 && paid_out[1] < free_m, "{paid_out:?}");
    }

    #[test]
    fn a_turning_drum_continues_and_its_time_is_as_uncertain_as_its_brake() {
        let (model, rest, mut kept) = hanging("paper-optimistic", 0.0);
        let cut = Cut {
            unseen_s: 0.01,
            unseen_sd_s: 0.005,
            ..CUT
        };
        let stood = lengths_after(&model, &rest, &kept, &cut);
        kept.cables[1].speed_mps = -0.04;
        let moved = lengths_after(&model, &rest, &kept, &cut);
        let way_m = moved.mean_m[1] - stood.mean_m[1];
        // 30 ms of brake and 10 ms unseen at 40 mm/s, and the way of stopping 34 kg with 100 N.
        assert!((-2.2e-3..-1.6e-3).contains(&way_m), "{way_m}");
        assert!(moved.sigma_m(1) > stood.sigma_m(1) + 1e-4);
        assert!((moved.sigma_m(0) - stood.sigma_m(0)).abs() < 1e-9);
    }

    #[test]
    fn a_rail_that_holds_up_shortens_the_fall_until_the_contactor_opens() {
        let fallen = |hold_up_s: f64, speed_mps: f64| {
            let (model, rest, mut kept) = hanging("lab-fast", hold_up_s);
            kept.cables[0].speed_mps = speed_mps;
            let after = lengths_after(&model, &rest, &kept, &CUT);
            (after.mean_m[0] - kept.cables[0].length_m, after.sigma_m(0))
        };
        let [(none_m, none_sd_m), (half_m, _), (all_m, all_sd_m)] =
            [0.0, 0.015, 0.05].map(|hold_up_s| fallen(hold_up_s, 0.0));
        // Half the time, a quarter of the way; the way of the closing brake adds to both.
        assert!((0.2..0.4).contains(&(half_m / none_m)), "{half_m} {none_m}");
        // 14 of 31.5 ms are left after the contactor, however long the rail lasts.
        assert!((0.15..0.3).contains(&(all_m / none_m)), "{all_m} {none_m}");
        assert!(all_sd_m < none_sd_m, "{all_sd_m} {none_sd_m}");
        assert!((all_m - fallen(0.02, 0.0).0).abs() < 1e-12);
        // A drum that turns at 0.2 m/s is stopped within the drive's lag, 5 ms, and not by the brake.
        let (stopped_m, _) = fallen(0.05, 0.2);
        let stopped_m = stopped_m - all_m;
        assert!((0.9e-3..1.15e-3).contains(&stopped_m), "{stopped_m}");
    }

    #[test]
    fn a_board_that_fails_alone_leaves_torque_on_the_drums_until_its_contactor_opens() {
        let (model, rest, kept) = hanging("lab-fast", 0.0);
        let held = Cut {
            torque_gone: 0.0,
            ..CUT
        };
        let held = lengths_after(&model, &rest, &kept, &held);
        let unknown = Cut {
            torque_gone: 0.5,
            ..CUT
        };
        let unknown = lengths_after(&model, &rest, &kept, &unknown);
        let gone = lengths_after(&model, &rest, &kept, &CUT);
        let way_m = |lengths: &Lengths| lengths.mean_m[0] - kept.cables[0].length_m;
        let share = way_m(&held) / way_m(&gone);
        assert!((0.15..0.3).contains(&share), "{share}");
        assert!(unknown.sigma_m(0) > 2.0 * KNOWN_M);
    }
}
