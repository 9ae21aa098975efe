//! What `commission` measured, as a picture: every value that is identified is a line through measured points.

use super::{Commissioned, Loss, Rubbing};
use crate::chart::{Chart, Curve, Figure};

/// Millinewton metres.
const MNM: f64 = 1e3;

/// The measurements of one winch, and the lines that were laid through them.
pub(crate) fn figure(found: &Commissioned, robot: &str) -> Figure {
    let mut charts = Vec::new();
    if let Some(rubs) = &found.rubbing {
        charts.push(friction(rubs));
        charts.push(play(rubs));
    }
    if let Some(loss) = &found.loss {
        charts.push(lifted(loss));
    }
    if !found.windings.is_empty() {
        charts.push(wound(found));
    }
    Figure::new(
        format!("{robot}, winch {} commissioned", found.winch),
        2,
        charts,
    )
}

/// Speed of the fastest turns, rpm.
fn fastest_rpm(rubs: &Rubbing) -> f64 {
    rubs.turns.iter().map(|turn| turn.rpm).fold(0.0, f64::max)
}

/// A measured value with one standard error to either side, as a vertical stroke.
fn errors(points: impl Iterator<Item = (f64, f64, f64)>) -> Vec<(f64, f64)> {
    // A curve is interrupted where it has no number.
    points
        .flat_map(|(x, y, se)| [(x, y - se), (x, y + se), (x, f64::NAN)])
        .collect()
}

fn friction(rubs: &Rubbing) -> Chart {
    let taken = rubs.turns.iter().map(|t| (t.rpm, t.torque_nm * MNM));
    let spread = rubs
        .turns
        .iter()
        .map(|t| (t.rpm, t.torque_nm * MNM, t.torque_se_nm * MNM));
    let mut curves = vec![
        Curve::new("half of both directions' difference", 1, taken).crosses(),
        Curve::new("", 1, errors(spread)),
    ];
    let title = match &rubs.friction {
        Some(found) => {
            let at = |rpm: f64| {
                (
                    rpm,
                    (found.friction_nm + found.viscous_nm_per_rpm * rpm) * MNM,
                )
            };
            curves.push(Curve::new("line", 0, [0.0, fastest_rpm(rubs)].map(at)));
            format!("friction {:.3} mN m", found.friction_nm * MNM)
        }
        None => "friction not known".to_owned(),
    };
    Chart::new(title, "motor speed, rpm", "motor torque, mN m").with(curves)
}

fn play(rubs: &Rubbing) -> Chart {
    let seen = rubs.turns.iter().map(|t| (t.rpm, t.gap_deg));
    let spread = rubs.turns.iter().map(|t| (t.rpm, t.gap_deg, t.gap_se_deg));
    let at = |rpm: f64| (rpm, rubs.play_deg + rubs.gap_deg_per_rpm * rpm);
    let title = format!("play {:.2} degrees", rubs.play_deg);
    Chart::new(title, "motor speed, rpm", "motor ahead of drum, degrees").with([
        Curve::new("difference of both directions", 1, seen).crosses(),
        Curve::new("", 1, errors(spread)),
        Curve::new("line", 0, [0.0, fastest_rpm(rubs)].map(at)),
    ])
}

fn lifted(loss: &Loss) -> Chart {
    let turns = || loss.turns.iter();
    let title = format!(
        "loss: {:.0} %, driven {:.0} %",
        loss.efficiency * 100.0,
        loss.backdrive_efficiency * 100.0
    );
    Chart::new(title, "motor speed, rpm", "motor torque, mN m").with([
        Curve::new("raising", 1, turns().map(|t| (t.rpm, t.raised_nm * MNM))).crosses(),
        Curve::new("lowering", 2, turns().map(|t| (t.rpm, t.lowered_nm * MNM))).crosses(),
        Curve::new("bare", 7, turns().map(|t| (t.rpm, t.bare_nm * MNM))).crosses(),
    ])
}

fn wound(found: &Commissioned) -> Chart {
    let names = ["wound one way", "the other way"];
    let mut curves: Vec<_> = names
        .iter()
        .zip(&found.windings)
        .enumerate()
        .map(|(index, (name, way))| Curve::new(*name, index + 1, way.iter().copied()))
        .collect();
    let title = match &found.stiffness {
        Some(yields) => {
            // Beside the upper ends: where each way begins, the motor passes friction and play.
            for way in &found.windings {
                let Some((last_deg, last_nm)) = way.last().copied() else {
                    continue;
                };
                let below_nm = 0.5 * last_nm;
                let back_deg = (below_nm / yields.before_loss_nm_per_rad).to_degrees();
                let line = [
                    (last_deg - back_deg, last_nm - below_nm),
                    (last_deg, last_nm),
                ];
                curves.push(Curve::new("", 0, line).dashed());
            }
            format!("stiffness {:.0} N m/rad", yields.stiffness_nm_per_rad)
        }
        None => "stiffness not known".to_owned(),
    };
    Chart::new(
        title,
        "motor's angle at the drum, degrees",
        "torque before loss, N m",
    )
    .with(curves)
}
