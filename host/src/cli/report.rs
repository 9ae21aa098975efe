//! `mcdpr report RUN` and `mcdpr compare RUN RUN`: recorded runs as HTML pages.

use super::table::lay_out;
use super::{Common, Failed, Outcome, print_json};
use crate::chart::{Figure, PlotFormat};
use crate::record::{self, RecordedRun};
use crate::replay::recorded_robot;
use crate::report::{Judgement, html, judge};
use crate::robot::Robot;
use std::path::{Path, PathBuf};

/// Write a run as one HTML page: plots, figures, verdicts, events
#[derive(Debug, clap::Args)]
pub(crate) struct Report {
    /// The run's folder, or its run.mcap
    run: PathBuf,
    /// The page, instead of report.html in the run's folder
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Compare two runs: figures beside each other, plots over each other
#[derive(Debug, clap::Args)]
pub(crate) struct Compare {
    /// The first run's folder, or its run.mcap
    first: PathBuf,
    /// The second run
    second: PathBuf,
    /// The page, instead of compare.html in the first run's folder
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

fn load(path: &std::path::Path) -> miette::Result<(RecordedRun, Robot, Judgement)> {
    let run = record::load(path)?;
    if let Some(damage) = &run.damage {
        eprintln!("{}", damage.words());
    }
    let robot = recorded_robot(&run)?;
    let judgement = judge(&run, &robot);
    Ok((run, robot, judgement))
}

fn write(
    out: Option<&PathBuf>,
    run: &RecordedRun,
    name: &str,
    page: &str,
) -> miette::Result<PathBuf> {
    let path = out.cloned().unwrap_or_else(|| {
        let folder = run.path.parent().map(PathBuf::from).unwrap_or_default();
        folder.join(name)
    });
    crate::files::write_atomically(&path, page).map_err(Failed::from_error("writing the page"))?;
    Ok(path)
}

/// The file of a plan's tube in a run's folder.
pub(crate) const TUBE: &str = "tube.json";

impl Report {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let (run, robot, judgement) = load(&self.run)?;
        let tube = tube(&run);
        let page = html::report(&run, &robot, &judgement, tube.as_deref());
        let path = write(self.out.as_ref(), &run, "report.html", &page)?;
        let plots = common.plots.map(|kind| {
            let figures = html::figures(&run, &robot, &judgement);
            write_plots(&path, figures, kind)
        });
        let plots = plots.transpose()?.unwrap_or_default();
        if common.json {
            return print_json(&serde_json::json!({
                "page": path.display().to_string(), "plots": plots, "judgement": judgement,
                "tube": tube,
            }));
        }
        let rows = judgement.verdicts.iter().map(|verdict| {
            let word = if verdict.pass { "pass" } else { "FAIL" };
            vec![
                verdict.what.clone(),
                word.to_owned(),
                verdict.numbers.clone(),
            ]
        });
        super::write_out(&lay_out(&rows.collect::<Vec<_>>()));
        if let Some(tube) = tube {
            say!("{tube}");
        }
        say!("{}", path.display());
        for plot in plots {
            say!("{plot}");
        }
        Ok(())
    }
}

/// What the plan of a run stated of the tool's error, and whether it held, from the run's folder.
pub(crate) fn tube(run: &RecordedRun) -> Option<String> {
    let file = run.path.parent()?.join(TUBE);
    let text = crate::files::read_text(file).ok()?;
    let value: serde_json::Value = serde_json::from_str(&text).ok()?;
    let words = format!("Stated by the plan: {}", value["words"].as_str()?);
    Some(match value["inside"].as_f64() {
        Some(inside) => format!(
            "{words}. The simulated tool was inside for {:.1} % of the path",
            inside * 100.0
        ),
        None => words,
    })
}

/// Writes plots into the folder `plots` beside a page; gives their files.
fn write_plots(
    page: &Path,
    figures: Vec<(String, Figure)>,
    kind: PlotFormat,
) -> miette::Result<Vec<String>> {
    let folder = page.parent().map(Path::to_owned).unwrap_or_default();
    let folder = folder.join("plots");
    let failed = || Failed::from_error("writing the plots");
    std::fs::create_dir_all(&folder).map_err(failed())?;
    let mut files = Vec::new();
    for (stem, figure) in figures {
        let path = folder.join(format!("{stem}.{}", kind.ending()));
        crate::files::write_atomically(&path, figure.file(kind)?).map_err(failed())?;
        files.push(path.display().to_string());
    }
    Ok(files)
}

impl Compare {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let (first, _, one) = load(&self.first)?;
        let (second, _, two) = load(&self.second)?;
        let both = [(&first, &one), (&second, &two)];
        let path = write(
            self.out.as_ref(),
            &first,
            "compare.html",
            &html::compare(both),
        )?;
        if common.json {
            return print_json(&serde_json::json!({
                "page": path.display().to_string(), "first": one, "second": two,
            }));
        }
        super::write_out(&lay_out(&html::compare_rows(both)));
        say!("{}", path.display());
        Ok(())
    }
}
