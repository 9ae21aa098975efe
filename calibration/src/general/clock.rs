//! Times that cannot be right: they are not used, and samples whose stated rates contradict them count as moving.

use super::data::Set;

/// Largest rate of a cable that is believed, m/s: no winch of such a robot is as fast.
const FASTEST_MPS: f64 = 20.0;
/// Samples closer than this belong to one motion or rest, s.
const NEAR_S: f64 = 1.0;
/// A length may change by this factor of what the stated speeds allow, and by this much more, m.
const MORE: f64 = 3.0;
const ALLOWANCE_M: f64 = 5e-3;

/// Checks the times of every session, and rates that are stated against lengths and times. What it changes is noted.
pub(super) fn check(set: &mut Set) {
    for session in 0..set.sessions.len() {
        let members: Vec<usize> = (0..set.samples.len())
            .filter(|&k| set.samples[k].session == session && set.samples[k].time_s.is_some())
            .collect();
        let pairs = || {
            members
                .windows(2)
                .filter_map(|pair| <[usize; 2]>::try_from(pair).ok())
        };
        let wrong = pairs().find_map(|[a, b]| Some((b, impossible(set, a, b)?)));
        if let Some((at, why)) = wrong {
            set.notes.push(format!(
                "{}: {why}; the times of session {} are not used",
                set.name(at),
                set.sessions[session]
            ));
            for &k in &members {
                set.samples[k].time_s = None;
            }
            continue;
        }
        let found: Vec<(usize, f64, f64)> = pairs()
            .filter_map(|[a, b]| {
                let rate = contradiction(set, a, b)?;
                Some((b, set.samples[b].speed_mps?, rate))
            })
            .collect();
        for (k, stated, rate) in found {
            set.notes.push(format!(
                "{}: a speed of {:.1} mm/s is stated, but a length changed at {:.1} mm/s since the sample before: \
                 it counts as moving",
                set.name(k),
                stated * 1e3,
                rate * 1e3
            ));
            set.samples[k].speed_mps = Some(rate);
        }
    }
}

/// Time between two samples and the largest change of a length, s and m.
fn step(set: &Set, a: usize, b: usize) -> Option<(f64, f64)> {
    let (a, b) = (set.samples.get(a)?, set.samples.get(b)?);
    let pairs = a.length_m.iter().zip(&b.length_m);
    let most = pairs.filter_map(|(a, b)| Some(((*b)? - (*a)?).abs()));
    Some((b.time_s? - a.time_s?, most.fold(0.0, f64::max)))
}

fn impossible(set: &Set, a: usize, b: usize) -> Option<String> {
    let (passed_s, moved_m) = step(set, a, b)?;
    if passed_s <= 0.0 {
        return Some("its time is not after that of the sample before".to_owned());
    }
    (moved_m / passed_s > FASTEST_MPS).then(|| {
        format!(
            "a length changed by {:.0} mm within {passed_s:.4} s: times must be in seconds",
            moved_m * 1e3
        )
    })
}

/// The rate by lengths and times where it contradicts the stated ones, m/s.
fn contradiction(set: &Set, a: usize, b: usize) -> Option<f64> {
    let (passed_s, moved_m) = step(set, a, b)?;
    let stated = set.samples[a].speed_mps?.max(set.samples[b].speed_mps?);
    let most = MORE * stated * passed_s + ALLOWANCE_M;
    (passed_s < NEAR_S && moved_m > most).then(|| moved_m / passed_s)
}
