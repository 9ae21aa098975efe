//! `mcdpr study tube`: whether the tool stays inside the tubes that plans state.

use crate::cli::plan::doubts;
use crate::cli::table::lay_out;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use crate::control::Handle;
use crate::machine::Mismatch;
use crate::motion::Model;
use crate::run::{RunError, interrupted, watch_for_interrupts};
use crate::study::quantile;
use crate::study::tube::{AtRests, Audit, audit, audit_tracked};
use indicatif::{ProgressBar, ProgressStyle};
use mcdpr_core::estimate::tube::Belief;
use rayon::prelude::*;
use serde_json::json;

/// Random plans on random machines: the share of path time with the tool inside the stated tube
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Plans, each on a machine of its own seed
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    plans: u64,
    /// Each machine is tracked at its rests and does several plans, one after the other; their tubes are by what is tracked
    #[arg(long)]
    tracked: bool,
    /// Plans of each tracked machine
    #[arg(long, default_value_t = 5, requires = "tracked", value_parser = clap::value_parser!(u64).range(1..=1000))]
    each: u64,
    /// A tracked machine sees its tags at every rest
    #[arg(long, requires = "tracked")]
    look: bool,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let default = if self.tracked {
            "after-hours"
        } else {
            "as-built"
        };
        let kind = common.machine.as_deref().unwrap_or(default);
        let mismatch = Mismatch::named(kind).unwrap_or(Mismatch::as_built());
        let anchors_mm = match kind {
            "realistic" => 0.3,
            "exact" => 0.0,
            _ => 5.0,
        };
        let robot = crate::robot::find(&common.robot)?;
        let model = Model::new(&robot)?;
        if self.look && robot.tags.is_empty() {
            let reason = format!("{} has no tags in its file", robot.name);
            return Err(Failed::from_error("--look")(reason).into());
        }
        let belief = Belief::of(&robot, &doubts(anchors_mm, 0.0));
        let prior = crate::cli::track::prior(&robot);
        let rests = AtRests {
            prior: &prior,
            looks: self.look,
        };
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        let bar = ProgressBar::new(self.plans);
        if let Ok(style) = ProgressStyle::with_template("{msg} [{wide_bar}] {pos}/{len} {eta}") {
            bar.set_style(style);
        }
        bar.set_message("plans");
        let each = if self.tracked { self.each } else { 1 };
        let machines = self.plans.div_ceil(each);
        let seeds = common.seed..common.seed.saturating_add(machines);
        let results: Vec<(u64, Result<Vec<Audit>, RunError>)> = seeds
            .into_par_iter()
            .filter(|_| !interrupted())
            .map(|seed| {
                let handle = Handle::new();
                let done = if self.tracked {
                    let on = (&common.controller, &handle);
                    let plans = usize::try_from(each).unwrap_or(1);
                    audit_tracked(&model, rests, mismatch, seed, plans, on)
                } else {
                    audit(&model, &belief, mismatch, seed, &common.controller, &handle)
                        .map(|audit| vec![audit])
                };
                bar.inc(each);
                (seed, done)
            })
            .collect();
        bar.finish_and_clear();
        if interrupted() {
            return Err(RunError::Interrupted.into());
        }
        let mut failed = Vec::new();
        let mut audits = Vec::new();
        for (seed, result) in results {
            match result {
                Ok(audit) => audits.extend(audit),
                Err(error) => failed.push(format!("seed {seed}: {error}")),
            }
        }
        let seconds: f64 = audits.iter().map(|a| a.path_s).sum();
        let inside = audits.iter().map(|a| a.inside_s).sum::<f64>() / seconds.max(1e-9);
        let whole = audits.iter().filter(|a| a.inside_s >= a.path_s).count();
        let column = |of: &dyn Fn(&Audit) -> f64| {
            let at = |share| quantile(audits.iter().map(of).collect(), share);
            [at(0.5), at(0.0), at(1.0)]
        };
        let stopped = audits.iter().filter(|a| a.stopped.is_some()).count();
        let rows = [
            (
                "radius of the tube, mean, mm",
                column(&|a| a.radius_mean_m * 1e3),
            ),
            (
                "error of the tool, mean, mm",
                column(&|a| a.error_mean_m * 1e3),
            ),
            (
                "error of the tool, greatest, mm",
                column(&|a| a.error_max_m * 1e3),
            ),
            ("radius needed over radius stated", column(&|a| a.needed)),
        ];
        if common.json {
            let figures: serde_json::Map<_, _> = rows
                .iter()
                .map(|(name, [median, least, most])| {
                    let value = json!({ "median": median, "least": least, "most": most });
                    ((*name).to_owned(), value)
                })
                .collect();
            return print_json(&json!({
                "study": "tube",
                "robot": common.robot,
                "machine": kind,
                "tracked": self.tracked,
                "look": self.look,
                "first_seed": common.seed,
                "machines": machines,
                "plans": audits.len(),
                "failed": failed,
                "path_s": seconds,
                "inside": inside,
                "plans_wholly_inside": whole,
                "stopped_early": stopped,
                "figures": figures,
                "each": audits,
            }));
        }
        let head = ["of a plan", "median", "least", "most"];
        let mut table = vec![head.map(str::to_owned).to_vec()];
        for (name, values) in rows {
            let cells = values.map(|value| format!("{value:.3}"));
            table.push([vec![name.to_owned()], cells.to_vec()].concat());
        }
        write_out(&lay_out(&table));
        say!(
            "{} plans, {seconds:.0} s of path: the tool is inside the tube for {:.1} % of it; {whole} plans lie \
             wholly inside; {stopped} were stopped by a fault, and count as far as they came",
            audits.len(),
            inside * 100.0
        );
        for line in failed {
            say!("{line}");
        }
        Ok(())
    }
}
