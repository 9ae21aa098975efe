//! The loop of Levenberg and Marquardt (Levenberg, 1944; Marquardt, 1963), for least squares
//! outside the hot solvers of this crate: the damping falls after a successful step and rises after
//! a failed one.

/// Start, change and end of the damping.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Damping {
    /// Damping of the first step; its meaning depends on the step, mostly a share of the diagonal.
    pub start: f64,
    /// Least damping.
    pub least: f64,
    /// Above this the descent ends: no step reduces the cost any more.
    pub most: f64,
    /// Factor after a successful step, below 1.
    pub after_success: f64,
    /// Factor after a failed step, above 1.
    pub after_failure: f64,
    /// Most steps, failed ones included.
    pub steps: usize,
}

/// Result of a step: `S` is the state, `L` the quantities computed there (cost, normal equations).
#[derive(Clone, Debug)]
pub enum Attempt<S, L> {
    /// The cost is not greater there: continue from it.
    Better(S, L),
    /// As [`Attempt::Better`], but the gain is so small that the descent ends there.
    Last(S, L),
    /// The step is taken, but is too small to evaluate the state after it. The descent ends there.
    Unseen(S),
    /// The cost is greater there, or cannot be computed, or there is no such step.
    Worse,
    /// No step is worth taking. The descent ends at the present state.
    Enough,
}

/// The end of a descent.
#[derive(Clone, Debug)]
pub struct Descent<S, L> {
    /// The state.
    pub at: S,
    /// The quantities computed there; after [`Attempt::Unseen`], those of a step before.
    pub linear: L,
    /// Steps tried.
    pub steps: usize,
}

/// Descends from a state by steps that `attempt` computes with a damping; `None` as soon as it
/// returns `None`.
///
/// ```
/// use mcdpr_kinematics::{Attempt, Damping, descend};
/// // The square root of 2 as the least of (x x - 2)^2: its residual has the slope 2 x.
/// let residual = |x: &f64| x * x - 2.0;
/// let damping = Damping { start: 1e-3, least: 1e-12, most: 1e6, after_success: 0.1, after_failure: 10.0, steps: 50 };
/// let found = descend(3.0, residual(&3.0), &damping, |x, r, damping| {
///     let slope = 2.0 * x;
///     let trial = x - slope * r / (slope * slope * (1.0 + damping));
///     let next = residual(&trial);
///     Some(match next.abs() <= r.abs() {
///         true if next.abs() < 1e-12 => Attempt::Last(trial, next),
///         true => Attempt::Better(trial, next),
///         false => Attempt::Worse,
///     })
/// });
/// assert!((found.unwrap().at - 2f64.sqrt()).abs() < 1e-12);
/// ```
pub fn descend<S, L>(
    start: S,
    linear: L,
    damping: &Damping,
    mut attempt: impl FnMut(&S, &L, f64) -> Option<Attempt<S, L>>,
) -> Option<Descent<S, L>> {
    let mut out = Descent {
        at: start,
        linear,
        steps: 0,
    };
    let mut now = damping.start;
    while out.steps < damping.steps {
        out.steps += 1;
        match attempt(&out.at, &out.linear, now)? {
            Attempt::Better(at, linear) => {
                (out.at, out.linear) = (at, linear);
                now = (now * damping.after_success).max(damping.least);
            }
            Attempt::Last(at, linear) => {
                (out.at, out.linear) = (at, linear);
                break;
            }
            Attempt::Unseen(at) => {
                out.at = at;
                break;
            }
            Attempt::Worse => {
                now *= damping.after_failure;
                if now > damping.most {
                    break;
                }
            }
            Attempt::Enough => break,
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAMPING: Damping = Damping {
        start: 1.0,
        least: 0.01,
        most: 1e3,
        after_success: 0.1,
        after_failure: 10.0,
        steps: 20,
    };

    #[test]
    fn damping_falls_to_its_least_and_rises_to_its_most() {
        let mut seen = [0.0; 20];
        let mut count = 0;
        let down = descend(0, (), &DAMPING, |at, (), damping| {
            seen[count] = damping;
            count += 1;
            Some(Attempt::Better(at + 1, ()))
        })
        .unwrap();
        assert_eq!((down.at, down.steps), (20, 20));
        assert_eq!(seen[..4], [1.0, 0.1, 0.1 * 0.1, 0.01]);
        let up = descend(7, (), &DAMPING, |_, (), _| Some(Attempt::Worse)).unwrap();
        // With 1, 10, 100 and 1000; 10,000 would be too much.
        assert_eq!((up.at, up.steps), (7, 4));
    }

    #[test]
    fn it_ends_where_the_attempt_says() {
        let ends = [
            (Attempt::Last(2, "there"), 2, "there"),
            (Attempt::Unseen(2), 2, "here"),
            (Attempt::Enough, 1, "here"),
        ];
        for (end, at, linear) in ends {
            let found = descend(1, "here", &DAMPING, |_, _, _| Some(end.clone())).unwrap();
            assert_eq!((found.at, found.linear, found.steps), (at, linear, 1));
        }
        assert!(descend(1, (), &DAMPING, |_, (), _| None).is_none());
    }

    #[test]
    fn the_valley_of_rosenbrock_is_followed_to_its_end() {
        // Residuals 1 - x and 10 (y - x^2) (Rosenbrock, 1960): the least is at (1, 1).
        let residuals = |[x, y]: &[f64; 2]| [1.0 - x, 10.0 * (y - x * x)];
        let cost = |r: &[f64; 2]| r[0] * r[0] + r[1] * r[1];
        let damping = Damping {
            start: 1e-3,
            least: 1e-12,
            most: 1e8,
            steps: 200,
            ..DAMPING
        };
        let start = [-1.2, 1.0];
        let found = descend(start, residuals(&start), &damping, |at, r, damping| {
            // Rows of the Jacobian: (-1, 0) and (-20 x, 10).
            let a = -20.0 * at[0];
            let (h00, h01, h11) = (1.0 + a * a, 10.0 * a, 100.0);
            let (g0, g1) = (-r[0] + a * r[1], 10.0 * r[1]);
            let (h00, h11) = (h00 * (1.0 + damping), h11 * (1.0 + damping));
            let det = h00 * h11 - h01 * h01;
            let step = [(-g0 * h11 + g1 * h01) / det, (-g1 * h00 + g0 * h01) / det];
            let trial = [at[0] + step[0], at[1] + step[1]];
            let next = residuals(&trial);
            Some(if cost(&next) <= cost(r) {
                Attempt::Better(trial, next)
            } else {
                Attempt::Worse
            })
        })
        .unwrap();
        let off = (found.at[0] - 1.0).abs() + (found.at[1] - 1.0).abs();
        assert!(off < 1e-9, "{:?}", found.at);
    }
}
