//! `mcdpr calibrate study`: how accurate both methods are on simulated data.

use crate::calibration::check::POSES_MIN;
use crate::calibration::general::simulate::{Case, Outside};
use crate::calibration::general::study::{Region, region};
use crate::calibration::joint::Options;
use crate::calibration::simulate::{Setup, Silent, Target, simulate};
use crate::calibration::study::{SlipEnd, Trial, any_slip, median, slip_trial, trial};
use crate::cli::numbers::{not_negative, part, positive, small};
use crate::cli::table::lay_out;
use crate::cli::{Common, Failed, Outcome, print_json, write_out};
use rayon::prelude::*;
use std::path::PathBuf;

/// Measure the accuracy of both methods on simulated data of the paper's robot
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Number of seeds, each with its own robot, poses and noise
    #[arg(long, default_value_t = 24, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    seeds: u64,
    /// The tags on the floor
    #[arg(long, value_enum, default_value_t = On::Board)]
    target: On,
    /// Number of poses
    #[arg(long, default_value_t = 20)]
    poses: usize,
    /// Corner noise, px
    #[arg(long, default_value_t = 0.1, value_parser = positive)]
    corner_px: f64,
    /// Anchors are off by up to this per coordinate, mm
    #[arg(long, default_value_t = 5.0, value_parser = positive)]
    anchor_mm: f64,
    /// Encoder noise, mm
    #[arg(long, default_value_t = 0.05, value_parser = positive)]
    encoder_mm: f64,
    /// Poses anywhere and at any attitude, as in the paper's simulation (no statics)
    #[arg(long)]
    free_poses: bool,
    /// Choose the poses out of this many reachable ones (0: take them at random)
    #[arg(long, default_value_t = 0, value_name = "CANDIDATES")]
    chosen: usize,
    /// Draw pulley radii, attachments, drums, lens, tag size and mass from the priors of the joint
    /// method, instead of using the stated values: to test the stated covariance
    #[arg(long)]
    drawn: bool,
    /// Machines as found: each drum off by 0.3 %, load cells with gains and zeros of their own, equations of
    /// equilibrium that do not close; with --drawn
    #[arg(long)]
    found: bool,
    /// One cable slips by this much at some pose, either way: how often it is named, refused and accepted
    #[arg(long, value_name = "MM", value_parser = not_negative)]
    slip_mm: Option<f64>,
    /// An inclinometer on the platform, turned by some degrees, with this noise, degrees
    #[arg(long, value_name = "DEG", value_parser = positive)]
    inclinometer_deg: Option<f64>,
    /// The last pose is the first one again, as `calibrate collect` does
    #[arg(long)]
    revisit: bool,
    /// The stated places of tags and camera are off by this much, each in some direction, mm
    #[arg(long, default_value_t = 0.0, value_name = "MM", value_parser = not_negative)]
    start_mm: f64,
    /// They are turned by this much, each about some axis, degrees
    #[arg(long, default_value_t = 0.0, value_name = "DEG", value_parser = not_negative)]
    start_deg: f64,
    /// Instead: two sessions of a robot as found with these sensors; from the first it calibrates, in the second it
    /// tells its place
    #[arg(long, value_enum, value_name = "SENSORS", conflicts_with_all = [
        "target", "corner_px", "anchor_mm", "encoder_mm", "free_poses", "chosen", "drawn", "found", "slip_mm", "revisit",
        "inclinometer_deg",
        "start_mm", "start_deg", "no_statics", "tag_error", "k1", "drum_error", "ea_n", "loss", "outliers", "write",
    ])]
    sensors: Option<Sensors>,
    /// joint: leave the equations of equilibrium out
    #[arg(long)]
    no_statics: bool,
    /// The tags are larger than stated by this share
    #[arg(long, default_value_t = 0.0, value_parser = small)]
    tag_error: f64,
    /// The lens has this k1, which is not stated
    #[arg(long, default_value_t = 0.0, value_parser = small)]
    k1: f64,
    /// The drums are larger than assumed by this share
    #[arg(long, default_value_t = 0.0, value_parser = small)]
    drum_error: f64,
    /// The cables stretch: EA, N (0: not at all)
    #[arg(long, default_value_t = 0.0, value_parser = not_negative)]
    ea_n: f64,
    /// The pulleys lose up to this share of a tension, with either sign
    #[arg(long, default_value_t = 0.0, value_parser = part)]
    loss: f64,
    /// Share of the measurements that are outliers
    #[arg(long, default_value_t = 0.0, value_parser = part)]
    outliers: f64,
    /// Write the first seed's data to this file instead
    #[arg(long, value_name = "FILE")]
    write: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Sensors {
    /// Lengths and tensions
    Lengths,
    /// The same, swivel angles and an inclinometer
    Inclinometer,
    /// Lengths, tensions, positions by a tracker, and a tape
    Tracker,
    /// All of these, and attitudes by the tracker
    All,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum On {
    /// One tag of 100 mm
    Tag,
    /// 3 x 3 tags of 80 mm
    Board,
    /// Three loose tags of 80 mm
    Loose,
}

impl Cmd {
    fn setup(&self, seed: u64) -> Setup {
        Setup {
            target: match self.target {
                On::Tag => Target::Tag,
                On::Board => Target::Board,
                On::Loose => Target::Loose,
            },
            poses: self.poses,
            corner_px: self.corner_px,
            anchor_m: self.anchor_mm * 1e-3,
            encoder_m: self.encoder_mm * 1e-3,
            free_poses: self.free_poses,
            chosen_from: self.chosen,
            drawn: self.drawn || self.found,
            found: self.found,
            slip: self.slip_mm.map(|mm| any_slip(seed, self.poses, mm * 1e-3)),
            tilt_rad: self.inclinometer_deg.map(f64::to_radians),
            silent: Silent {
                tag: self.tag_error,
                k1: self.k1,
                drum: self.drum_error,
                compliance_per_n: if self.ea_n > 0.0 {
                    1.0 / self.ea_n
                } else {
                    0.0
                },
                loss: self.loss,
                outliers: self.outliers,
            },
            revisit: self.revisit,
            start: [self.start_mm * 1e-3, self.start_deg.to_radians()],
            seed,
        }
    }

    /// Whether the region that a calibration by other sensors states holds the robot's place.
    fn regions(&self, common: &Common, sensors: Sensors) -> Outcome {
        let one = |i: u64| {
            region(&Case {
                samples: [self.poses, self.poses],
                attitude: matches!(sensors, Sensors::Inclinometer | Sensors::All),
                outside: match sensors {
                    Sensors::Lengths | Sensors::Inclinometer => Outside::None,
                    Sensors::Tracker => Outside::Positions,
                    Sensors::All => Outside::Poses,
                },
                seed: common.seed + i,
                ..Case::default()
            })
        };
        let ends: Vec<Result<Region, String>> = (0..self.seeds).into_par_iter().map(one).collect();
        let done: Vec<&Region> = ends.iter().flatten().collect();
        let refused: Vec<&String> = ends.iter().filter_map(|end| end.as_ref().err()).collect();
        let of = |f: fn(&Region) -> f64| done.iter().map(|region| f(region)).collect::<Vec<_>>();
        let inside = of(|r| r.inside).iter().sum::<f64>() / done.len().max(1) as f64;
        let (rms_mm, stated_mm) = (
            median(of(|r| r.rms_m)) * 1e3,
            median(of(|r| r.stated_m)) * 1e3,
        );
        if common.json {
            return print_json(&serde_json::json!({
                "seeds": self.seeds, "first_seed": common.seed, "poses": self.poses, "inside_95": inside,
                "rms_mm": rms_mm, "stated_mm": stated_mm, "refused": refused,
            }));
        }
        say!(
            "{} machines: place in the second session {rms_mm:.2} mm off (median), {stated_mm:.2} mm stated; {:.1} % \
             within the 95 % region",
            done.len(),
            inside * 100.0
        );
        for reason in refused {
            say!("refused: {reason}");
        }
        Ok(())
    }

    /// How slips while the data were collected are found.
    fn slips(&self, common: &Common, options: &Options) -> Outcome {
        let ends: Vec<Option<SlipEnd>> = (0..self.seeds)
            .into_par_iter()
            .map(|i| slip_trial(&self.setup(common.seed + i), options))
            .collect();
        let count = |end: &SlipEnd| ends.iter().flatten().filter(|e| e.same_kind(end)).count();
        let (named, refused) = (
            count(&SlipEnd::Named),
            count(&SlipEnd::Refused(String::new())),
        );
        let (held, wrong) = (
            count(&SlipEnd::Accepted { holds: true }),
            count(&SlipEnd::Accepted { holds: false }),
        );
        if common.json {
            return print_json(&serde_json::json!({
                "seeds": self.seeds, "first_seed": common.seed, "slip_mm": self.slip_mm, "named": named,
                "refused_otherwise": refused, "accepted_region_holds": held, "accepted_wrongly": wrong,
            }));
        }
        say!(
            "of {} data sets: slip named {named}, refused without its name {refused}",
            ends.len()
        );
        say!("accepted: {held} with a region that holds, {wrong} with one that does not");
        for end in ends.iter().flatten() {
            if let SlipEnd::Refused(words) = end {
                say!("refused: {words}");
            }
        }
        Ok(())
    }

    /// Combinations of numbers that are valid only on their own.
    fn checked(&self) -> Result<(), Failed> {
        if self.poses < POSES_MIN {
            let why = format!(
                "{} are too few to calibrate with: {POSES_MIN} or more",
                self.poses
            );
            return Err(Failed::from_error("--poses")(why));
        }
        if self.chosen > 0 && self.chosen < self.poses {
            let why = format!(
                "{} candidates for {} poses: give more, or 0 for poses at random",
                self.chosen, self.poses
            );
            return Err(Failed::from_error("--chosen")(why));
        }
        Ok(())
    }

    pub(crate) fn run(&self, common: &Common) -> Outcome {
        self.checked()?;
        if let Some(file) = &self.write {
            let what = format!("simulated data {}", file.display());
            let (data, _) = simulate(&self.setup(common.seed))
                .ok_or("no robot")
                .map_err(Failed::from_error(&what))?;
            let text = data.to_json().to_string();
            crate::files::write_atomically(file, text).map_err(Failed::from_error(&what))?;
            return Ok(());
        }
        if let Some(sensors) = self.sensors {
            return self.regions(common, sensors);
        }
        let options = Options {
            without_statics: self.no_statics,
            ..Options::default()
        };
        if self.slip_mm.is_some() {
            return self.slips(common, &options);
        }
        let trials: Vec<Result<Trial, String>> = (0..self.seeds)
            .into_par_iter()
            .map(|i| trial(&self.setup(common.seed + i), &options))
            .collect();
        let done: Vec<&Trial> = trials.iter().flatten().collect();
        let of = |f: &dyn Fn(&Trial) -> Option<f64>| {
            done.iter().filter_map(|t| f(t)).collect::<Vec<_>>()
        };
        let rms = |f: &dyn Fn(&Trial) -> Option<f64>| median(of(f)) * 1e3;
        let joint_mm = rms(&|t| Some(t.joint.rms_m));
        let paper_mm = rms(&|t| t.paper.as_ref().map(|e| e.rms_m));
        let none_mm = rms(&|t| t.none.as_ref().map(|e| e.rms_m));
        let predicted_mm = rms(&|t| Some(t.predicted_m));
        let yaw_deg = median(of(&|t| Some(t.joint.yaw_rms_rad))).to_degrees();
        let paper_yaw_deg = median(of(&|t| t.paper.as_ref().map(|e| e.yaw_rms_rad))).to_degrees();
        let chi = median(of(&|t| Some(t.chi_ratio)));
        let inside = of(&|t| Some(t.joint.inside_95));
        let inside = inside.iter().sum::<f64>() / inside.len().max(1) as f64;
        let rejected = median(of(&|t| Some(t.rejected as f64)));
        let refused: Vec<&String> = trials.iter().filter_map(|t| t.as_ref().err()).collect();
        if let (true, Some(first)) = (done.is_empty(), refused.first()) {
            return Err(Failed::from_error("no seed gave a calibration")(first).into());
        }
        if common.json {
            return print_json(&serde_json::json!({
                "seeds": self.seeds, "joint_mm": joint_mm, "paper_mm": paper_mm, "none_mm": none_mm,
                "joint_yaw_deg": yaw_deg, "paper_yaw_deg": paper_yaw_deg,
                "predicted_mm": predicted_mm, "chi_square_per_dof": chi, "inside_95": inside,
                "rejected_rows": rejected, "refused": refused,
            }));
        }
        let row = |name: &str, mm: f64, deg: f64| {
            vec![name.to_owned(), format!("{mm:.3}"), format!("{deg:.3}")]
        };
        write_out(&lay_out(&[
            ["median over seeds", "position, mm", "yaw, deg"]
                .map(str::to_owned)
                .to_vec(),
            row("joint", joint_mm, yaw_deg),
            row("paper", paper_mm, paper_yaw_deg),
            vec![
                "no calibration".to_owned(),
                format!("{none_mm:.3}"),
                String::new(),
            ],
            vec![
                "joint, predicted".to_owned(),
                format!("{predicted_mm:.3}"),
                String::new(),
            ],
        ]));
        say!("chi-square per degree of freedom {chi:.3}; rejected rows {rejected:.0}");
        say!(
            "inside the stated 95 % region: {:.1} % of the held-out poses",
            inside * 100.0
        );
        for reason in &refused {
            say!("refused: {reason}");
        }
        Ok(())
    }
}
