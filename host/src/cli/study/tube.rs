//! `mcdpr study tube`: whether the tool stays inside the tubes that plans state.

use crate::cli::plan::doubts;
use crate::cli::table::lay_out;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use crate::control::Handle;
use crate::machine::Mismatch;
use crate::motion::Model;
use crate::run::{RunError, interrupted, watch_for_interrupts};
use crate::study::quantile;
use crate::study::tube::{Audit, audit};
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
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let kind = common.machine.as_deref().unwrap_or("as-built");
        let mismatch = Mismatch::named(kind).unwrap_or(Mismatch::as_built());
        let anchors_mm = match kind {
            "realistic" => 0.3,
            "exact" => 0.0,
            _ => 5.0,
        };
        let robot = crate::robot::find(&common.robot)?;
        let model = Model::new(&robot)?;
        let belief = Belief::of(&robot, &doubts(anchors_mm, 0.0));
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        let bar = ProgressBar::new(self.plans);
        if let Ok(style) = ProgressStyle::with_template("{msg} [{wide_bar}] {pos}/{len} {eta}") {
            bar.set_style(style);
        }
        bar.set_message("plans");
        let seeds = common.seed..common.seed.saturating_add(self.plans);
        let results: Vec<(u64, Result<Audit, RunError>)> = seeds
            .into_par_iter()
            .filter(|_| !interrupted())
            .map(|seed| {
                let handle = Handle::new();
                let done = audit(&model, &belief, mismatch, seed, &common.controller, &handle);
                bar.inc(1);
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
                Ok(audit) => audits.push(audit),
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
                "first_seed": common.seed,
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
