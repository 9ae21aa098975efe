//! How close a motion comes to each limit, and where.

use super::allowance;
use super::model::{Model, StaticState};
use nalgebra::Vector3;
use serde::Serialize;
use std::fmt;

/// The point of a motion that comes closest to a limit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Margin {
    /// The limited quantity, in words.
    pub what: String,
    /// Its value there.
    pub value: f64,
    /// The limit, same unit.
    pub limit: f64,
    /// Unit of both.
    pub unit: &'static str,
    /// Distance to the limit, negative beyond it, percent: of the allowed range where the quantity has
    /// two limits, else of the larger of value and limit.
    pub left_percent: f64,
    /// Path time, s.
    pub time_s: f64,
    /// The tool, world, m.
    pub tool_m: [f64; 3],
}

/// A quantity with a limit; cables and axes from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Quantity {
    Axis(usize),
    Tilt,
    LeastTension(usize),
    GreatestTension(usize),
    Speed(usize),
    Current(usize),
    GearLoad(usize),
    DrumLength(usize),
    CableDistance,
}

impl Quantity {
    const fn unit(self) -> &'static str {
        match self {
            Self::Axis(_) | Self::DrumLength(_) | Self::CableDistance => "mm",
            Self::Tilt => "deg",
            Self::LeastTension(_) | Self::GreatestTension(_) | Self::GearLoad(_) => "N",
            Self::Speed(_) => "mm/s",
            Self::Current(_) => "A",
        }
    }
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Axis(axis) => write!(f, "tool's {}", ["x", "y", "z"].get(axis).unwrap_or(&"?")),
            Self::Tilt => f.write_str("tilt of the platform"),
            Self::LeastTension(cable) => write!(f, "least tension, cable {}", cable + 1),
            Self::GreatestTension(cable) => write!(f, "greatest tension, cable {}", cable + 1),
            Self::Speed(cable) => write!(f, "speed, cable {}", cable + 1),
            Self::Current(cable) => write!(f, "motor current, cable {}", cable + 1),
            Self::GearLoad(cable) => write!(f, "load on gear, cable {}", cable + 1),
            Self::DrumLength(cable) => write!(f, "length off drum, cable {}", cable + 1),
            Self::CableDistance => f.write_str("distance between cables"),
        }
    }
}

/// A moment of a motion.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moment {
    /// Path time, s.
    pub(super) time_s: f64,
    /// The tool, world, m.
    pub(super) tool_m: Vector3<f64>,
}

/// The closest points so far.
#[derive(Debug, Default)]
pub(super) struct Margins {
    kept: Vec<(Quantity, Margin)>,
}

impl Margins {
    /// Notes a value; `left` is its distance to the limit as a share.
    fn note(&mut self, what: Quantity, value: f64, limit: f64, left: f64, at: Moment) {
        let found = self.kept.iter().position(|(known, _)| *known == what);
        let now = || Margin {
            what: String::new(),
            value,
            limit,
            unit: what.unit(),
            left_percent: left * 100.0,
            time_s: at.time_s,
            tool_m: at.tool_m.into(),
        };
        match found.and_then(|index| self.kept.get_mut(index)) {
            Some((_, kept)) if left * 100.0 < kept.left_percent => *kept = now(),
            Some(_) => {}
            None => self.kept.push((what, now())),
        }
    }

    /// Notes a quantity between two limits.
    fn between(&mut self, what: [Quantity; 2], value: f64, [low, high]: [f64; 2], at: Moment) {
        let range = (high - low).max(f64::MIN_POSITIVE);
        self.note(what[0], value, low, (value - low) / range, at);
        self.note(what[1], value, high, (high - value) / range, at);
    }

    /// Notes a quantity below a limit.
    fn below(&mut self, what: Quantity, value: f64, limit: f64, at: Moment) {
        // Over the larger one: a value of ten times the limit is -90 %, not -900 %.
        let left = (limit - value) / limit.max(value).max(f64::MIN_POSITIVE);
        self.note(what, value, limit, left, at);
    }

    /// Notes a resting state.
    pub(super) fn take_state(&mut self, model: &Model, rest: &StaticState, at: Moment) {
        let robot = model.robot();
        let limits = &robot.limits;
        if let Some([low, high]) = &limits.box_in_world_m {
            let tool_m = model.asked(&at.tool_m);
            for axis in 0..3 {
                let range = [low[axis] * 1e3, high[axis] * 1e3];
                let what = [Quantity::Axis(axis); 2];
                self.between(what, tool_m[axis] * 1e3, range, at);
            }
        }
        let tilt_deg = rest.equilibrium.pose.tilt_rad().to_degrees();
        self.below(
            Quantity::Tilt,
            tilt_deg,
            limits.tilt_max_rad.to_degrees(),
            at,
        );
        let cables = rest.tensions_n().iter().zip(&rest.paid_out_m);
        for (cable, (&tension_n, &paid_out_m)) in cables.enumerate() {
            let Some(winch) = robot.winch_of(cable) else {
                continue;
            };
            let what = [
                Quantity::LeastTension(cable),
                Quantity::GreatestTension(cable),
            ];
            self.between(what, tension_n, allowance::planned_n(robot, cable), at);
            let most_m = winch.turns_max * std::f64::consts::TAU * winch.drum_radius_m;
            let what = Quantity::DrumLength(cable);
            self.below(what, paid_out_m * 1e3, most_m * 1e3, at);
        }
    }

    /// Notes the pay-out speeds of cables (m/s) and the forces of their winches (N).
    pub(super) fn take_speeds(
        &mut self,
        model: &Model,
        speeds: &[f64],
        forces: &[f64],
        at: Moment,
    ) {
        for (cable, (speed, force_n)) in speeds.iter().zip(forces).enumerate() {
            let Some(winch) = model.robot().winch_of(cable) else {
                continue;
            };
            let most_mps = winch.max_cable_speed_mps();
            let what = Quantity::Speed(cable);
            self.below(what, speed.abs() * 1e3, most_mps * 1e3, at);
            let current_a = force_n / winch.force_per_current_n_per_a();
            self.below(Quantity::Current(cable), current_a, winch.max_current_a, at);
        }
    }

    /// Notes the forces of the gears on the flank that the cable loads, N: 0 changes sides.
    pub(super) fn take_flanks(&mut self, model: &Model, flanks: &[Option<f64>], at: Moment) {
        let most_n = model.robot().limits.tension_max_n.max(f64::MIN_POSITIVE);
        for (cable, force) in flanks.iter().enumerate() {
            if let Some(force_n) = *force {
                self.note(
                    Quantity::GearLoad(cable),
                    force_n,
                    0.0,
                    force_n / most_n,
                    at,
                );
            }
        }
    }

    /// Notes the distance between the closest cables, m.
    pub(super) fn take_distance(&mut self, near_m: f64, least_m: f64, at: Moment) {
        let left = (near_m - least_m) / near_m.max(least_m);
        self.note(
            Quantity::CableDistance,
            near_m * 1e3,
            least_m * 1e3,
            left,
            at,
        );
    }

    /// All of them, the closest first.
    pub(super) fn sorted(self) -> Vec<Margin> {
        let named = self.kept.into_iter().map(|(what, margin)| Margin {
            what: what.to_string(),
            ..margin
        });
        let mut all: Vec<_> = named.collect();
        all.sort_by(|a, b| a.left_percent.total_cmp(&b.left_percent));
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AT: Moment = Moment {
        time_s: 1.0,
        tool_m: Vector3::new(0.1, 0.2, 0.3),
    };

    #[test]
    fn the_closest_point_is_kept_and_the_closest_limit_comes_first() {
        let mut margins = Margins::default();
        let later = Moment { time_s: 2.0, ..AT };
        margins.below(Quantity::Tilt, 5.0, 10.0, AT);
        margins.below(Quantity::Tilt, 9.0, 10.0, later);
        margins.below(Quantity::Tilt, 2.0, 10.0, AT);
        let tensions = [Quantity::LeastTension(1), Quantity::GreatestTension(1)];
        margins.between(tensions, 30.0, [2.0, 34.0], AT);
        let all = margins.sorted();
        let seen: Vec<_> = all
            .iter()
            .map(|m| (m.what.as_str(), m.left_percent))
            .collect();
        let expected = [
            ("tilt of the platform", 10.0),
            ("greatest tension, cable 2", 12.5),
            ("least tension, cable 2", 87.5),
        ];
        for ((what, left), (name, percent)) in seen.iter().zip(expected) {
            assert!(
                *what == name && (left - percent).abs() < 1e-9,
                "{what}: {left}"
            );
        }
        assert_eq!((seen.len(), all[0].time_s, all[0].value), (3, 2.0, 9.0));
    }

    #[test]
    fn a_broken_limit_has_a_negative_margin() {
        let mut margins = Margins::default();
        margins.below(Quantity::Current(0), 4.0, 2.0, AT);
        margins.take_distance(0.002, 0.005, AT);
        let all = margins.sorted();
        assert!((all[0].left_percent + 60.0).abs() < 1e-9, "{:?}", all[0]);
        assert!((all[1].left_percent + 50.0).abs() < 1e-9, "{:?}", all[1]);
        assert_eq!(all[1].what, "motor current, cable 1");
    }
}
