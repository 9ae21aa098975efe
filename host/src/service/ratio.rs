//! The motor ratio of a winch (Eq. 50 with the units of docs/paper-notes.md): motor counts per drum
//! encoder count.

use super::{Bench, Purpose, ServiceError};
use crate::link::{Client, Link};
use crate::robot::Robot;
use serde::Serialize;
use std::f64::consts::TAU;

/// Results from a drum's turns about motor, gear and encoder.
#[derive(Debug, Clone, Serialize)]
pub struct Ratio {
    /// Winch, 1 for the first.
    pub winch: usize,
    /// Motor counts per drum encoder count, signed; rho of Eq. 50.
    pub rho: f64,
    /// Standard deviation of rho from turn to turn.
    pub rho_sd: f64,
    /// Motor counts per drum turn: rho times the encoder's counts per turn.
    pub motor_counts_per_turn: f64,
    /// Motor counts lost at a change of direction, gear and coupling together.
    pub backlash_motor_counts: f64,
    /// Least backlash that this measurement can detect, motor counts.
    pub backlash_resolution: f64,
    /// Whether drum encoder and motor count the same way (1) or opposite ways (-1).
    pub same_way: i8,
    /// Encoder sign for the robot file, given that the file's motor sign is right.
    pub encoder_sign: i8,
    /// The robot file's rho, for comparison.
    pub rho_described: f64,
    /// Every turn's rho, out and back.
    pub turns: Vec<f64>,
}

/// Turns a bare drum one encoder revolution at a time, `turns` times out and back, and compares
/// motor and drum at rest. Takes some seconds per turn with a high gear.
///
/// # Errors
/// [`ServiceError::EncoderStuck`] if the encoder does not follow, [`ServiceError::MotorStuck`], and
/// those of a run.
pub fn measure_ratio<L: Link>(
    client: &mut Client<L>,
    robot: &Robot,
    winch: usize,
    turns: u32,
) -> Result<Ratio, ServiceError> {
    let mut bench = Bench::new(client, robot, winch)?;
    bench.find_zero()?;
    bench.enable(Purpose::Turn)?;
    let stops = ways(&mut bench, turns);
    // The brake closes in any case.
    let closed = bench.disable();
    let stops = stops?;
    closed?;
    judge(&bench, winch, &stops)
}

/// Motor and drum counts at every stop: a short way first, that takes up the play, then out and
/// back.
fn ways<L: Link>(bench: &mut Bench<'_, L>, turns: u32) -> Result<Vec<(i64, i64)>, ServiceError> {
    let run_up = TAU / 16.0;
    let mut at = 0.0;
    let mut stops = Vec::new();
    let step = |bench: &mut Bench<'_, L>, at: &mut f64, to: f64| {
        bench.turn(*at, to)?;
        *at = to;
        bench.at_rest()
    };
    let start = bench.at_rest()?;
    let first = step(bench, &mut at, run_up)?;
    check(bench, start, first, TAU / 16.0)?;
    stops.push(first);
    for turn in 1..=turns {
        stops.push(step(bench, &mut at, run_up + TAU * f64::from(turn))?);
    }
    // Beyond, and back to the same position from the other side: the difference is the play.
    let end = at;
    step(bench, &mut at, end + run_up)?;
    for turn in (0..=turns).rev() {
        stops.push(step(bench, &mut at, run_up + TAU * f64::from(turn))?);
    }
    Ok(stops)
}

/// Whether motor and drum encoder moved at all.
pub(super) fn check<L: Link>(
    bench: &Bench<'_, L>,
    from: (i64, i64),
    to: (i64, i64),
    way_rad: f64,
) -> Result<(), ServiceError> {
    let described = bench.described();
    let (motor, counted) = (to.0 - from.0, to.1 - from.1);
    let turns = way_rad.abs() / TAU;
    #[expect(clippy::cast_possible_truncation, reason = "some million")]
    let asked = (described.motor_counts_per_turn.abs() * turns) as i64;
    if motor.abs() < asked / 2 {
        return Err(ServiceError::MotorStuck {
            winch: bench.index + 1,
            moved: motor,
            asked,
        });
    }
    // A wrong ratio is what is searched for; a twentieth of the file's is not plausible.
    let least = f64::from(described.encoder_counts_per_turn) * turns / 20.0;
    if (counted.unsigned_abs() as f64) < least {
        return Err(ServiceError::EncoderStuck {
            winch: bench.index + 1,
            counted,
            motor,
        });
    }
    Ok(())
}

fn judge<L: Link>(
    bench: &Bench<'_, L>,
    winch: usize,
    stops: &[(i64, i64)],
) -> Result<Ratio, ServiceError> {
    let described = bench.described();
    let half = stops.len() / 2;
    let (out, back) = stops.split_at(half);
    let mut turns = Vec::new();
    for way in [out, back] {
        for pair in way.windows(2) {
            if let [from, to] = pair {
                check(bench, *from, *to, TAU / 16.0)?;
                turns.push((to.0 - from.0) as f64 / (to.1 - from.1) as f64);
            }
        }
    }
    let count = turns.len().max(1) as f64;
    // The whole distance of each direction at once: end counts have the least weight.
    let whole = |way: &[(i64, i64)]| match (way.first(), way.last()) {
        (Some(first), Some(last)) => ((last.0 - first.0) as f64, (last.1 - first.1) as f64),
        _ => (0.0, 0.0),
    };
    let (a, b) = (whole(out), whole(back));
    // Least squares through the origin over both directions.
    let rho = (a.0 * a.1 + b.0 * b.1) / (a.1 * a.1 + b.1 * b.1);
    let squares: f64 = turns.iter().map(|turn| (turn - rho).powi(2)).sum();
    // Motor counts without drum counts: the difference between the two directions.
    let rest = |way: &[(i64, i64)]| {
        let sum: f64 = way.iter().map(|s| s.0 as f64 - rho * s.1 as f64).sum();
        sum / way.len().max(1) as f64
    };
    let same_way = if rho < 0.0 { -1 } else { 1 };
    let motor_sign = described.motor_counts_per_turn.signum();
    let per_count = described.motor_counts_per_encoder_count().abs();
    Ok(Ratio {
        winch,
        rho,
        rho_sd: (squares / (count - 1.0).max(1.0)).sqrt(),
        motor_counts_per_turn: rho.abs()
            * f64::from(described.encoder_counts_per_turn)
            * motor_sign,
        backlash_motor_counts: (rest(out) - rest(back)).abs(),
        // An encoder count of uncertainty on either side.
        backlash_resolution: rho.abs(),
        same_way,
        encoder_sign: if motor_sign < 0.0 {
            -same_way
        } else {
            same_way
        },
        rho_described: per_count * motor_sign * f64::from(described.encoder_sign),
        turns,
    })
}
