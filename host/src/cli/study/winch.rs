//! `mcdpr study winch`: the tension loop on winches over the whole range of friction, loss and play.

use crate::cli::table::lay_out;
use crate::cli::{Common, Outcome, print_json, write_out};
use crate::tension::winch_study::{
    Drawn, FIGURES, FRICTION_N, OF_TENSION, contenders, median_and_p95, spread, study,
};

/// The tension loop on machines drawn over the typical range of friction, gear efficiency and play:
/// medians and 95th percentiles, the paper's law beside the default, and by friction
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Machines
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u64).range(1..=10000))]
    seeds: u64,

    /// Seed of the first machine
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Limits of the groups by friction, N.
const BINS_N: [[f64; 2]; 4] = [[1.0, 3.0], [3.0, 10.0], [10.0, 20.0], [20.0, 31.0]];

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let robot = crate::robot::find(&common.robot)?;
        let seeds = self.seed..self.seed.saturating_add(self.seeds);
        let drawn = study(&robot, seeds.clone());
        let last = seeds.end.saturating_sub(1);
        if common.json {
            return print_json(&serde_json::json!({
                "study": "winch",
                "robot": robot.name,
                "seeds": format!("{} to {last}", self.seed),
                "figures": FIGURES.map(|(name, unit, _)| format!("{name}, {unit}")),
                "contenders": contenders(&robot).iter().map(|c| c.name).collect::<Vec<_>>(),
                "machines": drawn,
            }));
        }
        let all = [0.0, f64::INFINITY];
        let names: Vec<_> = contenders(&robot).iter().map(|c| c.name).collect();
        let mut head = vec![
            "simulation, median / p95 (machines)".to_owned(),
            String::new(),
        ];
        head.extend(names.iter().map(|name| (*name).to_owned()));
        head.push("paper".to_owned());
        let cell = |contender, figure, within| match spread(&drawn, contender, figure, within) {
            Some((median, p95, count)) => format!("{median:.3} / {p95:.3} ({count})"),
            None if contender > 0 && figure >= OF_TENSION => "-".to_owned(),
            None => "fault".to_owned(),
        };
        let mut rows = vec![head];
        for (figure, (name, unit, paper)) in FIGURES.iter().enumerate() {
            let mut cells = vec![(*name).to_owned(), (*unit).to_owned()];
            cells.extend((0..names.len()).map(|contender| cell(contender, figure, all)));
            cells.push((*paper).to_owned());
            rows.push(cells);
        }
        write_out(&lay_out(&rows));
        let mut head = vec![
            "default, by friction at the cable".to_owned(),
            String::new(),
        ];
        head.extend(
            BINS_N.map(|[low, high]| format!("{low:.0} to {:.0} N", high.min(FRICTION_N[1]))),
        );
        let mut rows = vec![head];
        for (figure, (name, unit, _)) in FIGURES.iter().enumerate() {
            let mut cells = vec![(*name).to_owned(), (*unit).to_owned()];
            cells.extend(BINS_N.map(|within| cell(0, figure, within)));
            rows.push(cells);
        }
        write_out(&lay_out(&rows));
        identified(&drawn);
        for machine in &drawn {
            for (name, run) in names.iter().zip(&machine.runs) {
                for fault in &run.faults {
                    say!(
                        "seed {}: {:.1} N, {:.0} %, {:.2} degrees, {name}: {fault}",
                        machine.seed,
                        machine.friction_n,
                        machine.efficiency * 100.0,
                        machine.play_deg
                    );
                }
            }
        }
        say!("robot {}, seeds {} to {last}", robot.name, self.seed);
        Ok(())
    }
}

/// How well `commission` identified the winches.
fn identified(drawn: &[Drawn]) {
    let winches: Vec<_> = drawn.iter().flat_map(|machine| &machine.found).collect();
    let friction = winches.iter().filter_map(|found| found.friction_error);
    let friction: Vec<f64> = friction.map(|share| share.abs() * 100.0).collect();
    let known = friction.len();
    if let Some((median, p95, _)) = median_and_p95(friction) {
        say!(
            "commission: friction known on {known} of {} winches, off by {median:.1} % (median), {p95:.1} % (95 %)",
            winches.len()
        );
    }
    for [low, high] in BINS_N {
        let within = |machine: &&Drawn| (low..high).contains(&machine.friction_n);
        let of = drawn
            .iter()
            .filter(within)
            .flat_map(|machine| &machine.found);
        let friction = of.filter_map(|found| found.friction_error);
        let friction: Vec<f64> = friction.map(|share| share.abs() * 100.0).collect();
        if let Some((median, p95, count)) = median_and_p95(friction) {
            say!(
                "commission: friction of {low:.0} to {:.0} N on {count} winches off by {median:.1} % (median), {p95:.1} % (95 %)",
                high.min(FRICTION_N[1])
            );
        }
    }
    let ratio = winches.iter().map(|found| found.ratio_error.abs() * 100.0);
    if let Some((median, p95, count)) = median_and_p95(ratio.collect()) {
        say!(
            "commission: motor counts per turn of {count} winches off by {median:.3} % (median), {p95:.3} % (95 %)"
        );
    }
    let play = winches.iter().map(|found| found.play_error_deg.abs());
    if let Some((median, p95, count)) = median_and_p95(play.collect()) {
        say!(
            "commission: play of {count} winches off by {median:.3} degrees (median), {p95:.3} (95 %)"
        );
    }
}
