//! `mcdpr study calibrated`: a calibrated robot at places that were not measured.

use crate::cli::progress::Count;
use crate::cli::table::lay_out;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use crate::machine::Mismatch;
use crate::motion::{Model, Shaping};
use crate::run::{RunError, interrupted, watch_for_interrupts};
use crate::study::calibrated::{Judged, Place, Work, judge};
use crate::study::quantile;
use rayon::prelude::*;

/// Machines (`--machine`, as built without) that are calibrated over the board of tags, at places that were not measured: error, and share of
/// places within the region that the calibration states
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Machines
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    seeds: u64,

    /// Poses per calibration
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u16).range(7..=200))]
    poses: u16,

    /// Places per machine
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u16).range(1..=200))]
    places: u16,

    /// Shape the motions between the places against swing
    #[arg(long, value_enum, default_value_t = Shaping::None)]
    shaping: Shaping,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let robot = crate::robot::find(&common.robot)?;
        Model::new(&robot)?;
        let kind = common.machine.as_deref().unwrap_or("as-built");
        let mismatch = Mismatch::named(kind).unwrap_or(Mismatch::as_built());
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        let work = Work {
            poses: self.poses.into(),
            places: self.places.into(),
            shaping: self.shaping,
        };
        let count = Count::begin("machines", self.seeds);
        let seeds = common.seed..common.seed.saturating_add(self.seeds);
        let last = seeds.end.saturating_sub(1);
        let all: Vec<Judged> = seeds
            .into_par_iter()
            .filter(|_| !interrupted())
            .map(|seed| {
                let judged = judge(&robot, mismatch, &work, seed);
                count.one_more();
                judged
            })
            .collect();
        drop(count);
        if interrupted() {
            return Err(RunError::Interrupted.into());
        }
        let done: Vec<_> = all.iter().filter(|of| !of.places.is_empty()).collect();
        if let (true, Some(first)) = (done.is_empty(), all.first()) {
            let why = first.stopped.clone().unwrap_or_default();
            let why = format!("no machine reached a place; seed {}: {why}", first.seed);
            return Err(Failed::from_error("study calibrated")(why).into());
        }
        if common.json {
            return print_json(&serde_json::json!({
                "study": "calibrated",
                "robot": robot.name,
                "seeds": format!("{} to {last}", common.seed),
                "machine": kind,
                "poses": self.poses,
                "shaping": self.shaping,
                "machines": all,
            }));
        }
        let head = ["of a machine, root mean square", "median", "5 %", "95 %"];
        let mut table = vec![head.map(str::to_owned).to_vec()];
        for (kinds, unit, scale) in [
            (&LENGTHS[..], "mm", 1e3),
            (&ANGLES[..], "degrees", 1f64.to_degrees()),
        ] {
            for (name, value) in kinds {
                let values = of_machine(&done, *value);
                let of = |share| format!("{:.3}", quantile(values.clone(), share) * scale);
                table.push(vec![format!("{name}, {unit}"), of(0.5), of(0.05), of(0.95)]);
            }
        }
        write_out(&lay_out(&table));
        let places: Vec<_> = done.iter().flat_map(|of| &of.places).collect();
        let share = |count: usize| 100.0 * count as f64 / places.len().max(1) as f64;
        let inside = places.iter().filter(|place| place.inside).count();
        let turned = places.iter().filter(|place| place.turned_inside).count();
        let within = |place: &&&Place| place.tool_m <= place.tube_m;
        let within = places.iter().filter(within).count();
        say!(
            "of {} places, in the region of 95 %: position {inside} ({:.1} %), attitude {turned} ({:.1} %); tool in the plan's \
             tube of 95 %: {within} ({:.1} %)",
            places.len(),
            share(inside),
            share(turned),
            share(within)
        );
        say!(
            "simulation, robot {}, machines {kind}, seeds {} to {last}, {} poses: {} of {} calibrated",
            robot.name,
            common.seed,
            self.poses,
            all.iter().filter(|of| of.calibrated).count(),
            all.len()
        );
        for of in &all {
            if let Some(why) = &of.stopped {
                say!("seed {}: {why}", of.seed);
            }
        }
        Ok(())
    }
}

/// A value of a place, m or rad.
type Value = fn(&Place) -> f64;
const LENGTHS: [(&str, Value); 5] = [
    ("position", |place| place.position_m),
    ("expected position", |place| place.expected_m),
    ("tool", |place| place.tool_m),
    ("plans' tube of 95 %", |place| place.tube_m),
    ("swing of the position", |place| place.swing_m),
];
const ANGLES: [(&str, Value); 3] = [
    ("attitude", |place| place.attitude_rad),
    ("expected attitude", |place| place.expected_rad),
    ("swing of the attitude", |place| place.swing_rad),
];

/// Root mean square over the places of each machine.
fn of_machine(machines: &[&Judged], value: Value) -> Vec<f64> {
    let square = |of: &&Judged| {
        let sum: f64 = of.places.iter().map(|place| value(place).powi(2)).sum();
        (sum / of.places.len().max(1) as f64).sqrt()
    };
    machines.iter().map(square).collect()
}
