//! `mcdpr calibrate all`: solves recorded data.

use super::Method;
use super::collect::{How, data_path};
use crate::calibration::at_rest::AtRest;
use crate::calibration::paper::{AnchorTerm, Weights, paper};
use crate::calibration::{Answer, Data, Options, Refusal, history, joint, result};
use crate::cli::progress::Phase;
use crate::cli::table::lay_out;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use crate::run::Alone;
use std::path::PathBuf;

/// Find anchors, initial lengths, camera and tags: from recorded data, or collecting them first
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    #[command(flatten)]
    what: Solve,
    /// Estimator
    #[arg(long, value_enum, default_value_t = Method::Joint)]
    method: Method,
    /// joint: leave out tensions and the equations of equilibrium
    #[arg(long)]
    no_statics: bool,
    /// paper: the anchors' distance squared, in m^2 beside lengths in m, as Eq. 41 is printed
    #[arg(long)]
    literal: bool,
}

/// Find the frame of a robot that was reassembled from known winch modules, platform and camera
#[derive(Debug, clap::Args)]
pub(crate) struct FrameCmd {
    #[command(flatten)]
    what: Solve,
}

/// Find the camera's pose on the platform, for a robot whose frame is calibrated
#[derive(Debug, clap::Args)]
pub(crate) struct CameraCmd {
    #[command(flatten)]
    what: Solve,
}

/// Which data, and where the result goes.
#[derive(Debug, clap::Args)]
struct Solve {
    /// Calibration data (format mcdpr-calibration-data-1); without this, they are collected first
    #[arg(long, value_name = "FILE")]
    data: Option<PathBuf>,
    /// File for the result, by default NAME.calibration.json beside the robot file. Data that do
    /// not name their robot give an answer, but no result file
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    how: How,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        self.what
            .run(common, "calibrate all", |data| match self.method {
                Method::Joint => joint(
                    data,
                    &Options {
                        without_statics: self.no_statics,
                        closer_looks: true,
                        ..Options::default()
                    },
                ),
                Method::Paper => paper(
                    data,
                    &Weights {
                        term: if self.literal {
                            AnchorTerm::SquaredMetres
                        } else {
                            AnchorTerm::Millimetres
                        },
                        ..Weights::default()
                    },
                ),
            })
    }
}

impl FrameCmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        self.what.run(common, "calibrate frame", |data| {
            joint(data, &Options::frame_only())
        })
    }
}

impl CameraCmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let robot = common.robot()?;
        if robot.calibrated.is_none() {
            return Err(Failed::from_error("calibrate camera")(
                "the frame is not calibrated yet; `mcdpr calibrate all` finds both",
            )
            .into());
        }
        self.what.run(common, "calibrate camera", |data| {
            let mut data = data.clone();
            data.keep_frame_of(&robot);
            joint(&data, &Options::camera_only())
        })
    }
}

impl Solve {
    /// `cause` is what the history of the calibration says of it.
    fn run(
        &self,
        common: &Common,
        cause: &str,
        solve: impl Fn(&Data) -> Result<Answer, Refusal>,
    ) -> Outcome {
        let (data, designed) = match &self.data {
            Some(file) => {
                let what = format!("calibration data {}", file.display());
                let text = crate::files::read_text(file).map_err(Failed::from_error(&what))?;
                let data = refusable(common, Data::from_json(&text))?;
                // Data from elsewhere do not refer to a robot of this program.
                let wanted = data.origin.is_some() || self.out.is_some();
                (
                    data,
                    wanted
                        .then(|| crate::robot::find(&common.robot))
                        .transpose()?,
                )
            }
            None if common.dry_run => {
                let words = "calibrate` without `--data";
                return Err(crate::cli::dry::refusal(words).into());
            }
            None => {
                let robot = crate::robot::find(&common.robot)?;
                let data = self.how.run(&robot, &data_path(&common.robot), common)?;
                (data, Some(robot))
            }
        };
        // The robot of the collection is at rest, and its line is closed.
        let alone = Alone::begin();
        let phase = Phase::begin("calibrating");
        let solved = solve(&data);
        drop(phase);
        drop(alone);
        let answer = refusable(common, solved)?;
        let mut at_rest = None;
        let kept = match designed {
            Some(robot) => {
                let document = refusable(common, result::document(&robot, &data, &answer))?;
                at_rest = AtRest::by(&robot, &document);
                let out = self.out.clone();
                let used = result::path_for(&common.robot);
                let path = out.unwrap_or_else(|| used.clone());
                if !common.dry_run {
                    // A proposal elsewhere is not in use yet.
                    let counts = path == used;
                    if counts && result::apply(&robot, &path).is_ok() {
                        history::remember(&robot, &path, "found in use")?;
                    }
                    let text = serde_json::to_string_pretty(&document);
                    let text = text.map_err(Failed::from_error("the calibration"))?;
                    result::write_whole(&path, format!("{text}\n"))?;
                    if counts {
                        history::remember(&robot, &path, cause)?;
                    }
                }
                Some(path)
            }
            None => None,
        };
        if common.json {
            let mut document = answer.to_json();
            document["at_rest"] = serde_json::json!(at_rest);
            return print_json(&document);
        }
        show(&data, &answer, at_rest.as_ref());
        match kept {
            Some(path) if !common.dry_run => say!("written to {}", path.display()),
            _ => say!("nothing was written"),
        }
        Ok(())
    }
}

/// With `--json` a refusal is printed as the document.
fn refusable<T, E: std::fmt::Display + Into<miette::Report>>(
    common: &Common,
    result: Result<T, E>,
) -> miette::Result<T> {
    match result {
        Ok(value) => Ok(value),
        Err(refusal) => {
            if common.json {
                print_json(&serde_json::json!({ "refused": refusal.to_string() }))?;
            }
            Err(refusal.into())
        }
    }
}

fn show(data: &Data, answer: &Answer, at_rest: Option<&AtRest>) {
    show_cables(data, answer);
    show_places(answer);
    if let (Some(chi), Some(freedom)) = (answer.chi_square, answer.degrees_of_freedom) {
        say!(
            "\nchi-square {chi:.1} for {freedom:.0} degrees of freedom; rank {} of {} core unknowns",
            answer.rank,
            answer.core_unknowns
        );
    }
    if answer.predicted_error_m.is_finite() {
        say!(
            "predicted position error {:.2} mm by the cables' lengths, at the worst pose {:.2} mm",
            answer.predicted_error_m * 1e3,
            answer.worst_predicted_error_m * 1e3
        );
    }
    if let Some(at_rest) = at_rest {
        say!("{}", at_rest.words());
    }
    for words in &answer.unobservable {
        say!("not observable: {words}");
    }
    show_map(answer);
    show_next(answer);
    show_rejected(answer);
    for words in &answer.warnings {
        say!("warning: {words}");
    }
    say!(
        "verdict: accepted{}",
        if answer.warnings.is_empty() {
            ""
        } else {
            " with warnings"
        }
    );
}

/// Anchors and initial lengths, a row per cable.
fn show_cables(data: &Data, answer: &Answer) {
    let mut rows = vec![
        [
            "cable",
            "anchor x",
            "y",
            "z",
            "from nominal",
            "initial length",
        ]
        .map(str::to_owned)
        .to_vec(),
    ];
    for (i, (cable, nominal)) in answer.cables.iter().zip(&data.robot.cables).enumerate() {
        let off = (cable.anchor_m - nominal.anchor_m) * 1e3;
        rows.push(vec![
            (i + 1).to_string(),
            format!("{:.3}", cable.anchor_m.x * 1e3),
            format!("{:.3}", cable.anchor_m.y * 1e3),
            format!("{:.3}", cable.anchor_m.z * 1e3),
            format!("{:+.2} {:+.2} {:+.2}", off.x, off.y, off.z),
            format!("{:.3}", answer.initial_length_m[i] * 1e3),
        ]);
    }
    say!("method {}, lengths in mm\n", answer.method);
    write_out(&lay_out(&rows));
}

/// Tags, camera, and the further parameters where they were estimated.
fn show_places(answer: &Answer) {
    let place = |what: &str, pose: &mcdpr_kinematics::Pose| {
        let (p, a) = (pose.position_m * 1e3, pose.rpy().map(f64::to_degrees));
        say!(
            "{what:<24} {:9.3} {:9.3} {:9.3} mm  {:8.3} {:8.3} {:8.3} deg",
            p.x,
            p.y,
            p.z,
            a[0],
            a[1],
            a[2]
        );
    };
    say!("");
    for (i, body) in answer.world_from_body.iter().enumerate() {
        place(&format!("tags of body {i} in world"), body);
    }
    place("platform in camera", &answer.camera_from_platform);
    if let Some(further) = &answer.further {
        say!(
            "drums {:+.3} %, tags {:+.3} %, f {:.2} px, centre {:.2} {:.2} px, k1 {:+.5}",
            (further.drum_scale - 1.0) * 100.0,
            (further.tag_scale - 1.0) * 100.0,
            further.camera.focal_px[0],
            further.camera.center_px[0],
            further.camera.center_px[1],
            further.camera.distortion[0]
        );
        if let Some(statics) = &further.statics {
            let center = statics.center_of_mass_m;
            say!(
                "mass {:.4} kg, centre of mass {:.2} {:.2} {:.2} mm, 1/EA {:.2} per MN",
                statics.mass_kg,
                center.x * 1e3,
                center.y * 1e3,
                center.z * 1e3,
                statics.compliance_per_n * 1e6
            );
        }
    }
}

/// What one more pose would bring.
fn show_next(answer: &Answer) {
    if let Some(next) = &answer.next {
        let p = next.pose.position_m * 1e3;
        let [without, with] = next.expected_error_m;
        say!(
            "one more pose at {:.0} {:.0} {:.0} mm with cable {} at {:.1} N would take the expected \
             error over the reachable poses from {:.2} to {:.2} mm",
            p.x,
            p.y,
            p.z,
            next.held + 1,
            next.tension_n,
            without * 1e3,
            with * 1e3
        );
    }
}

/// The rejected rows, the first ones by name.
fn show_rejected(answer: &Answer) {
    const SHOWN: usize = 20;
    for row in answer.rejected.iter().take(SHOWN) {
        let mut which = format!("pose {} {}", row.pose, row.kind);
        if let Some(cable) = row.cable {
            which += &format!(" of cable {cable}");
        }
        if let (Some(tag), Some(corner)) = (row.tag, row.corner) {
            which += &format!(" {corner} of tag {tag}");
        }
        say!(
            "rejected: {which}, {:.1} standard deviations off",
            row.sigmas
        );
    }
    if answer.rejected.len() > SHOWN {
        say!(
            "rejected: {} more, see --json",
            answer.rejected.len() - SHOWN
        );
    }
}

/// The map of the expected error, one line per height.
fn show_map(answer: &Answer) {
    let mut heights: Vec<f64> = answer.map.iter().map(|p| p.at_m.z).collect();
    heights.dedup();
    for z in heights {
        let on = answer
            .map
            .iter()
            .filter(|p| p.at_m.z == z)
            .map(|p| p.rms_m * 1e3);
        let all: Vec<f64> = on.collect();
        let worst = all.iter().copied().fold(0.0, f64::max);
        let mean = all.iter().sum::<f64>() / all.len().max(1) as f64;
        say!(
            "expected error at z = {:6.0} mm: mean {mean:.2} mm, at the worst place {worst:.2} mm",
            z * 1e3
        );
    }
}
