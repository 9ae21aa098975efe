//! Jerk-limited motion along a length, from rest to rest.
//!
//! The law has seven phases: jerk up, constant acceleration, jerk down, cruise, and the same
//! mirrored. Any of the constant phases may have zero duration. It is symmetric in time, so it is
//! stored as four numbers (length and three durations) from which peak speed, acceleration and jerk
//! follow: end and duration are met exactly, independent of rounding.

/// Bounds on a motion along its path; each greater than 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Speed, m/s.
    pub speed_mps: f64,
    /// Acceleration along the path, m/s2.
    pub acceleration_mps2: f64,
    /// Jerk along the path, m/s3.
    pub jerk_mps3: f64,
}

/// One of the bounds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Bound {
    /// Speed.
    Speed,
    /// Acceleration.
    Acceleration,
    /// Jerk.
    Jerk,
    /// More than one of them at once.
    Several,
}

impl std::fmt::Display for Bound {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Bound::Speed => "the speed limit",
            Bound::Acceleration => "the acceleration limit",
            Bound::Jerk => "the jerk limit",
            Bound::Several => "speed, acceleration and jerk limits together",
        })
    }
}

/// Why a time law cannot be computed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TimeLawError {
    /// A length, bound or duration is not a number greater than 0 within 1e-12 to 1e12.
    #[error("{what} must be greater than 0 (1e-12 to 1e12), not {value}")]
    OutOfRange {
        /// Which value, with its unit.
        what: &'static str,
        /// What was given.
        value: f64,
    },
    /// The bounds do not allow the motion in the given time.
    #[error(
        "{:.3} mm cannot be travelled in {duration_s} s: {bound} allows no less than \
         {least_s:.4} s; take that long, or raise the limit",
        .length_m * 1e3
    )]
    TooShort {
        /// Length, m.
        length_m: f64,
        /// Duration asked, s.
        duration_s: f64,
        /// Least duration within the bounds, s.
        least_s: f64,
        /// The bound that alone prevents it; [`Bound::Several`] if no single one does.
        bound: Bound,
    },
}

/// Position along the path with its derivatives by time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State {
    /// Arc length travelled, m.
    pub position_m: f64,
    /// Speed, m/s.
    pub velocity_mps: f64,
    /// Acceleration along the path, m/s2.
    pub acceleration_mps2: f64,
    /// Jerk along the path, m/s3; at a change of phase, that of the later one.
    pub jerk_mps3: f64,
}

/// A jerk-limited motion over a length, from rest to rest.
///
/// ```
/// use mcdpr_core::motion::time_law::{Bounds, TimeLaw};
///
/// let bounds = Bounds { speed_mps: 1.0, acceleration_mps2: 1.0, jerk_mps3: 1.0 };
/// // 1 s up and 1 s down in jerk reach 1 m/s after 1 m; the same again to rest: 4 s for 2 m.
/// let law = TimeLaw::fastest(2.0, bounds)?;
/// assert!((law.duration_s() - 4.0).abs() < 1e-12);
/// assert!((law.at(2.0).velocity_mps - 1.0).abs() < 1e-12);
/// # Ok::<(), mcdpr_core::motion::time_law::TimeLawError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimeLaw {
    length_m: f64,
    /// Duration of one jerk phase.
    jerk_s: f64,
    /// Duration from rest to peak speed, both jerk phases included.
    rise_s: f64,
    /// Duration at peak speed.
    cruise_s: f64,
}

impl TimeLaw {
    /// The motion of least duration within the bounds.
    ///
    /// # Errors
    /// [`TimeLawError::OutOfRange`].
    pub fn fastest(length_m: f64, bounds: Bounds) -> Result<Self, TimeLawError> {
        check(length_m, bounds)?;
        Ok(Self::with_peak(
            length_m,
            bounds,
            peak_speed(length_m, bounds),
        ))
    }

    /// The motion that takes exactly `duration_s`, at the lowest peak speed that the bounds on
    /// acceleration and jerk allow.
    ///
    /// # Errors
    /// [`TimeLawError::TooShort`] names the limiting bound; [`TimeLawError::OutOfRange`].
    pub(crate) fn fit_duration(
        length_m: f64,
        bounds: Bounds,
        duration_s: f64,
    ) -> Result<Self, TimeLawError> {
        let fastest = Self::fastest(length_m, bounds)?;
        positive("the duration (s)", duration_s)?;
        let least_s = fastest.duration_s();
        // A duration that equals the least one up to rounding is possible.
        if duration_s < least_s * (1.0 - 1e-12) {
            return Err(TimeLawError::TooShort {
                length_m,
                duration_s,
                least_s,
                bound: bound_in_the_way(length_m, bounds, duration_s),
            });
        }
        // Duration = rise(V) + length / V falls with V as long as there is a cruise, and is at
        // least length / V: the peak speed lies between these.
        let mut low = (length_m / duration_s).min(peak_speed(length_m, bounds));
        let mut high = peak_speed(length_m, bounds);
        for _ in 0..200 {
            let middle = 0.5 * (low + high);
            if middle <= low || middle >= high {
                break;
            }
            if rise(middle, bounds).1 + length_m / middle > duration_s {
                low = middle;
            } else {
                high = middle;
            }
        }
        let (jerk_s, rise_s) = rise(high, bounds);
        Ok(Self {
            length_m,
            jerk_s,
            rise_s,
            // The cruise takes up what the bisection leaves: the duration is met exactly.
            cruise_s: (duration_s - 2.0 * rise_s).max(0.0),
        })
    }

    /// The same motion in more time: speed, acceleration and jerk get smaller.
    pub(crate) fn stretched_to(mut self, duration_s: f64) -> Self {
        let factor = (duration_s / self.duration_s()).max(1.0);
        self.jerk_s *= factor;
        self.rise_s *= factor;
        self.cruise_s *= factor;
        self
    }

    fn with_peak(length_m: f64, bounds: Bounds, peak_mps: f64) -> Self {
        let (jerk_s, rise_s) = rise(peak_mps, bounds);
        Self {
            length_m,
            jerk_s,
            rise_s,
            cruise_s: (length_m / peak_mps - rise_s).max(0.0),
        }
    }

    /// Length travelled, m.
    pub fn length_m(&self) -> f64 {
        self.length_m
    }

    /// Duration from rest to rest, s.
    pub fn duration_s(&self) -> f64 {
        2.0 * self.rise_s + self.cruise_s
    }

    /// Duration of the cruise at peak speed, s; 0 if there is none.
    #[cfg(test)]
    pub(crate) fn cruise_s(&self) -> f64 {
        self.cruise_s
    }

    /// Greatest speed, m/s. (The mean over a rise is half of it.)
    pub(crate) fn peak_speed_mps(&self) -> f64 {
        self.length_m / (self.rise_s + self.cruise_s)
    }

    /// Greatest acceleration, m/s2.
    pub(crate) fn peak_acceleration_mps2(&self) -> f64 {
        self.peak_speed_mps() / (self.rise_s - self.jerk_s)
    }

    /// Greatest jerk, m/s3.
    pub(crate) fn peak_jerk_mps3(&self) -> f64 {
        self.peak_acceleration_mps2() / self.jerk_s
    }

    /// Times at which the phases begin, and the end, s; phases without duration included.
    #[cfg(test)]
    pub(crate) fn phase_times_s(&self) -> [f64; 8] {
        let end = self.duration_s();
        let rise = [0.0, self.jerk_s, self.rise_s - self.jerk_s, self.rise_s];
        let [a, b, c, d] = rise;
        [a, b, c, d, end - d, end - c, end - b, end - a]
    }

    /// The state at `t_s` after the start; at rest before the start and after the end (NaN counts
    /// as before the start).
    pub fn at(&self, t_s: f64) -> State {
        let end = self.duration_s();
        if t_s >= end {
            return State {
                position_m: self.length_m,
                velocity_mps: 0.0,
                acceleration_mps2: 0.0,
                jerk_mps3: 0.0,
            };
        }
        // Before the cruise: without one, braking begins where the rise ends.
        if t_s >= end - self.rise_s {
            // The braking is the rise seen backwards, from the end.
            let mirror = self.rising(end - t_s, true);
            return State {
                position_m: self.length_m - mirror.position_m,
                velocity_mps: mirror.velocity_mps,
                acceleration_mps2: -mirror.acceleration_mps2,
                jerk_mps3: mirror.jerk_mps3,
            };
        }
        if t_s >= self.rise_s {
            let peak = self.peak_speed_mps();
            return State {
                position_m: peak * (t_s - 0.5 * self.rise_s),
                velocity_mps: peak,
                acceleration_mps2: 0.0,
                jerk_mps3: 0.0,
            };
        }
        self.rising(t_s, false)
    }

    /// The rise at `t` from rest. At a change of phase the later phase gives the jerk; in the
    /// mirrored half, the earlier one.
    fn rising(&self, t: f64, backwards: bool) -> State {
        let acceleration = self.peak_acceleration_mps2();
        let jerk = self.peak_jerk_mps3();
        let in_phase_before = |end: f64| t < end || (backwards && t <= end);
        if t.is_nan() || t <= 0.0 {
            State {
                position_m: 0.0,
                velocity_mps: 0.0,
                acceleration_mps2: 0.0,
                jerk_mps3: if t == 0.0 { jerk } else { 0.0 },
            }
        } else if in_phase_before(self.jerk_s) {
            State {
                position_m: jerk * t * t * t / 6.0,
                velocity_mps: 0.5 * jerk * t * t,
                acceleration_mps2: jerk * t,
                jerk_mps3: jerk,
            }
        } else if in_phase_before(self.rise_s - self.jerk_s) {
            // The velocity equals that of a constant acceleration begun half a jerk phase later.
            let late = t - 0.5 * self.jerk_s;
            State {
                position_m: acceleration * (0.5 * late * late + self.jerk_s.powi(2) / 24.0),
                velocity_mps: acceleration * late,
                acceleration_mps2: acceleration,
                jerk_mps3: 0.0,
            }
        } else {
            let left = self.rise_s - t;
            let peak = self.peak_speed_mps();
            State {
                // Cruise measured back from the point where the peak is reached, less the distance
                // not yet covered: the mirror of the first phase.
                position_m: peak * (0.5 * self.rise_s - left) + jerk * left * left * left / 6.0,
                velocity_mps: peak - 0.5 * jerk * left * left,
                acceleration_mps2: jerk * left,
                jerk_mps3: -jerk,
            }
        }
    }
}

fn positive(what: &'static str, value: f64) -> Result<(), TimeLawError> {
    if (1e-12..=1e12).contains(&value) {
        Ok(())
    } else {
        Err(TimeLawError::OutOfRange { what, value })
    }
}

fn check(length_m: f64, bounds: Bounds) -> Result<(), TimeLawError> {
    positive("the length (m)", length_m)?;
    positive("the speed limit (m/s)", bounds.speed_mps)?;
    positive("the acceleration limit (m/s2)", bounds.acceleration_mps2)?;
    positive("the jerk limit (m/s3)", bounds.jerk_mps3)
}

/// Durations of a jerk phase and of the whole rise to a peak speed.
fn rise(peak_mps: f64, bounds: Bounds) -> (f64, f64) {
    let (a, j) = (bounds.acceleration_mps2, bounds.jerk_mps3);
    // Above a^2 / j a phase of constant acceleration lies between the jerk phases: with 2 m/s2 and
    // 40 m/s3 above 0.1 m/s.
    if peak_mps * j > a * a {
        (a / j, a / j + peak_mps / a)
    } else {
        let jerk_s = (peak_mps / j).sqrt();
        (jerk_s, 2.0 * jerk_s)
    }
}

/// The greatest peak speed that the bounds and the length allow.
fn peak_speed(length_m: f64, bounds: Bounds) -> f64 {
    let (a, j) = (bounds.acceleration_mps2, bounds.jerk_mps3);
    // Without a cruise, length = V rise(V).
    let with_constant_acceleration = {
        let jerk_s = a / j;
        // V^2 / a + V a / j = length, the root in the form that does not cancel.
        2.0 * length_m / (jerk_s + (jerk_s * jerk_s + 4.0 * length_m / a).sqrt())
    };
    // Jerk phases of t each: V = j t^2 and length = 2 V t, so V^3 = j length^2 / 4.
    let without = libm::cbrt(0.25 * length_m * length_m * j);
    let reachable = if with_constant_acceleration * j > a * a {
        with_constant_acceleration
    } else {
        without
    };
    reachable.min(bounds.speed_mps)
}

/// The bound whose removal alone would make the duration possible.
fn bound_in_the_way(length_m: f64, bounds: Bounds, duration_s: f64) -> Bound {
    // 1e12 times the greatest valid bound: in effect no bound.
    let none = 1e24;
    let without = [
        (
            Bound::Speed,
            Bounds {
                speed_mps: none,
                ..bounds
            },
        ),
        (
            Bound::Acceleration,
            Bounds {
                acceleration_mps2: none,
                ..bounds
            },
        ),
        (
            Bound::Jerk,
            Bounds {
                jerk_mps3: none,
                ..bounds
            },
        ),
    ];
    without
        .into_iter()
        .find(|(_, freed)| {
            let law = TimeLaw::with_peak(length_m, *freed, peak_speed(length_m, *freed));
            law.duration_s() <= duration_s
        })
        .map_or(Bound::Several, |(bound, _)| bound)
}

#[cfg(test)]
mod tests;
