//! `mcdpr study winch`: the tension loop on winches over the whole range of friction, loss and play.

use crate::cli::progress::Count;
use crate::cli::table::lay_out;
use crate::cli::{Common, Outcome, print_json, write_out};
use crate::tension::winch_study::{
    Drawn, FIGURES, Identified, OF_TENSION, contenders, median_and_p95, spread, study,
};
use mcdpr_twin::gears::FRICTION_N;

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

    /// Only what `commission` finds: no tension loop, no path
    #[arg(long)]
    commission_only: bool,
}

/// Limits of the groups by friction, N.
const BINS_N: [[f64; 2]; 4] = [[1.0, 3.0], [3.0, 10.0], [10.0, 20.0], [20.0, 31.0]];

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let robot = crate::robot::find(&common.robot)?;
        let seeds = self.seed..self.seed.saturating_add(self.seeds);
        let count = Count::begin("machines", self.seeds);
        let drawn = study(&robot, seeds.clone(), self.commission_only, || {
            count.one_more();
        });
        drop(count);
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
        if self.commission_only {
            identified(&drawn);
            for machine in &drawn {
                for why in &machine.refused {
                    say!(
                        "seed {}: {:.1} N, {:.0} %, {:.2} degrees, {why}",
                        machine.seed,
                        machine.friction_n,
                        machine.efficiency * 100.0,
                        machine.play_deg
                    );
                }
            }
            say!("robot {}, seeds {} to {last}", robot.name, self.seed);
            return Ok(());
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
            None if !drawn.iter().any(|m| in_bin(within, m)) => "-".to_owned(),
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

/// Whether the friction of a machine is within these limits, N.
fn in_bin([low, high]: [f64; 2], machine: &Drawn) -> bool {
    (low..high).contains(&machine.friction_n)
}

/// How well `commission` identified the winches.
fn identified(drawn: &[Drawn]) {
    let within = |bin: [f64; 2]| {
        let of = drawn.iter().filter(|machine| in_bin(bin, machine));
        of.flat_map(|machine| &machine.found).collect::<Vec<_>>()
    };
    let all = [0.0, f64::INFINITY];
    let names = |[low, high]: [f64; 2]| {
        if high.is_finite() {
            format!("{low:.0} to {:.0} N", high.min(FRICTION_N[1]))
        } else {
            "all".to_owned()
        }
    };
    let mut bins = BINS_N.to_vec();
    bins.push(all);
    let mut head = vec!["commission, off by: median / p95 (known)".to_owned()];
    head.extend(bins.iter().map(|bin| names(*bin)));
    let mut rows = vec![head];
    for (name, digits, of) in ERRORS {
        let mut cells = vec![name.to_owned()];
        cells.extend(bins.iter().map(|bin| {
            let found = within(*bin);
            let errors = found.iter().filter_map(|found| of(found)).map(f64::abs);
            match median_and_p95(errors.collect()) {
                Some((median, p95, known)) => {
                    format!(
                        "{median:.digits$} / {p95:.digits$} ({known} of {})",
                        found.len()
                    )
                }
                None => "-".to_owned(),
            }
        }));
        rows.push(cells);
    }
    write_out(&lay_out(&rows));
    for machine in drawn {
        for (winch, found) in (1..).zip(&machine.found) {
            if let Some(why) = &found.stiffness_unknown {
                say!("seed {}, winch {winch}, stiffness: {why}", machine.seed);
            }
        }
    }
    let winches = within(all);
    for (name, error, stated) in STATED {
        let both = winches
            .iter()
            .filter_map(|found| error(found).zip(stated(found)));
        let both: Vec<_> = both.collect();
        let count = |times: f64| {
            let good = both.iter().filter(|(error, se)| error.abs() <= times * se);
            good.count()
        };
        say!(
            "{name}: {} of {} within one standard error, {} within two, {} within three",
            count(1.0),
            both.len(),
            count(2.0),
            count(3.0)
        );
    }
}

/// A value of one winch.
type Of = fn(&Identified) -> Option<f64>;

/// The errors that are listed, with digits.
const ERRORS: [(&str, usize, Of); 6] = [
    ("friction, %", 1, |found| {
        Some(found.friction_error? * 100.0)
    }),
    ("play, degrees", 3, |found| Some(found.play_error_deg)),
    ("efficiency, points", 1, |found| {
        Some(found.efficiency_error? * 100.0)
    }),
    ("efficiency driven, points", 1, |found| {
        Some(found.backdrive_error? * 100.0)
    }),
    ("stiffness, %", 1, |found| {
        Some(found.stiffness_error? * 100.0)
    }),
    ("motor counts per turn, %", 3, |found| {
        Some(found.ratio_error * 100.0)
    }),
];

/// Errors and their stated standard errors.
const STATED: [(&str, Of, Of); 4] = [
    ("friction", |f| f.friction_error, |f| f.friction_se),
    ("efficiency", |f| f.efficiency_error, |f| f.efficiency_se),
    (
        "efficiency driven",
        |f| f.backdrive_error,
        |f| f.backdrive_se,
    ),
    ("stiffness", |f| f.stiffness_error, |f| f.stiffness_se),
];
