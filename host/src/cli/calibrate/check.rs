//! `mcdpr calibrate check`: whether the calibration of a running robot still holds.

use crate::calibration::collect::{CollectError, recheck};
use crate::calibration::slip::{Finding, Sigmas};
use crate::cli::eye::Eye;
use crate::cli::recorded::{OnRecord, Work, on_record};
use crate::cli::{Common, Failed, Outcome, print_json};
use crate::control::Handle;
use crate::experiment::SimulatedRobot;
use crate::link::ClientError;
use crate::machine::Mismatch;
use crate::motion::Model;
use crate::record::Doing;
use crate::robot::Calibrated;
use crate::run::{Homing, LengthFiles, Session, watch_for_interrupts};
use crate::sight::{Scene, SimulatedTags, TagSource};

/// Share of a tension that is lost at pulleys before the sensor at the winch.
const PULLEYS: f64 = 0.02;

/// Check on the running robot that its calibration still holds; names a cable that slipped
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Measure at up to this many poses, the present one included
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u8).range(1..=9))]
    places: u8,
    /// Do not use the tags, even with a camera
    #[arg(long)]
    no_tags: bool,
    #[command(flatten)]
    eye: Eye,
    /// Share of a tension that is lost at the pulleys before its sensor
    #[arg(long, default_value_t = PULLEYS, value_name = "PART")]
    friction: f64,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let robot = common.robot()?;
        let Some(calibrated) = robot.calibrated.clone() else {
            return Err(Failed::from_error("calibrate check")(
                "this robot has no calibration to check; `mcdpr calibrate all` makes one",
            )
            .into());
        };
        if !(0.0..=0.5).contains(&self.friction) {
            return Err(Failed::from_error("--friction")(format!(
                "{} is not a share of a tension: give 0 to 0.5",
                self.friction
            ))
            .into());
        }
        let model = Model::new(&robot)?;
        model.comes_to_rest("the check of a running robot")?;
        watch_for_interrupts().map_err(Failed::from_error("watching for Ctrl-C"))?;
        // The pictures only decide how far the check goes.
        let built = Mismatch::as_built();
        let handle = Handle::new();
        let work = Work::new("calibrate-check", Doing::Orders, built, &model).with_orders(&handle);
        let (all, folder) = on_record(common, &work, |record| {
            self.look(common, &model, &calibrated, record, &handle)
        })?;
        eprintln!("run folder: {}", folder.path().display());
        let last = all.last().copied().unwrap_or(Finding::Holds);
        if common.json {
            print_json(&serde_json::json!({
                "holds": last == Finding::Holds,
                "finding": document(&last),
                "places": all.iter().map(document).collect::<Vec<_>>(),
            }))?;
        }
        match last {
            Finding::Holds => Ok(()),
            other => Err(Failed::from_error("calibrate check")(format!(
                "{}; {}",
                words(&other),
                match other {
                    Finding::Cable { .. } =>
                        "look at that drum, then home the robot at a tag (`mcdpr home`)",
                    _ => "look over frame and drums, then calibrate again (`mcdpr calibrate all`)",
                }
            ))
            .into()),
        }
    }

    /// Measures at one pose after the other, and reports the finding after each.
    fn look(
        &self,
        common: &Common,
        model: &Model,
        calibrated: &Calibrated,
        record: &OnRecord<'_>,
        handle: &Handle,
    ) -> miette::Result<Vec<Finding>> {
        let mut tags: Option<Box<dyn TagSource>> = None;
        let (link, homing) = if common.on == "sim" {
            self.eye.refused_on_simulator("--camera")?;
            let link = SimulatedRobot::new(Mismatch::as_built(), common.seed)
                .controller(&common.controller)
                .at_home(model)?;
            let scene = Scene::of(model.robot(), common.seed);
            let seen = SimulatedTags::new(link.clone(), scene, 0.1, common.seed);
            tags = Some(Box::new(seen));
            let home = Homing::Lengths(calibrated.home_lengths_m.clone());
            (record.simulated(link), home)
        } else {
            if let Some(seen) = self.eye.tags(model.robot(), &common.page)? {
                tags = Some(Box::new(seen));
            }
            let link = common.open_port().map_err(ClientError::from)?;
            (record.line(link), Homing::Known)
        };
        let mut session = Session::open(model, link, record.session, handle, homing, &LengthFiles)?;
        let error_m = calibrated.predicted_error_m.unwrap_or(1e-3);
        let sigmas = Sigmas::calibrated(error_m, self.friction, calibrated.covariance.is_some());
        let mut source = tags.as_mut().map(|source| source as &mut dyn TagSource);
        if self.no_tags {
            source = None;
        }
        let mut all = Vec::new();
        session.arm()?;
        let done = recheck(
            model,
            &mut session,
            source,
            usize::from(self.places),
            sigmas,
            |check, reading| {
                let found = check.finding();
                if !common.json {
                    say!(
                        "place {}, {}: {}",
                        check.readings(),
                        if reading.seen.is_some() {
                            "with tags"
                        } else {
                            "without tags"
                        },
                        words(&found)
                    );
                }
                all.push(found);
                true
            },
        );
        match done {
            // A link error or a fault that ended it has stopped the robot already.
            Err(error @ CollectError::Run(_)) => Err(error.into()),
            done => {
                session.disarm()?;
                done?;
                Ok(all)
            }
        }
    }
}

fn words(finding: &Finding) -> String {
    match finding {
        Finding::Holds => "the calibration holds".into(),
        Finding::Slip { about_m } => format!(
            "something slipped, by about {:.1} mm; more places or a tag will name the cable",
            about_m.abs() * 1e3
        ),
        Finding::Cable {
            cable,
            slip_m,
            sigma_m,
        } => format!(
            "cable {cable} is {:.2} mm {} than its encoder says (standard deviation {:.2} mm)",
            slip_m.abs() * 1e3,
            if *slip_m > 0.0 { "longer" } else { "shorter" },
            sigma_m * 1e3
        ),
        Finding::NoLongerHolds { ratio } => format!(
            "the calibration no longer holds: no single cable explains the readings (chi-square {ratio:.1} \
             per degree of freedom)"
        ),
    }
}

fn document(finding: &Finding) -> serde_json::Value {
    match finding {
        Finding::Holds => serde_json::json!({ "is": "holds" }),
        Finding::Slip { about_m } => serde_json::json!({ "is": "slip", "about_m": about_m }),
        Finding::Cable {
            cable,
            slip_m,
            sigma_m,
        } => serde_json::json!({
            "is": "cable", "cable": cable, "slip_m": slip_m, "sigma_m": sigma_m,
        }),
        Finding::NoLongerHolds { ratio } => {
            serde_json::json!({ "is": "no longer holds", "chi_square_per_dof": ratio })
        }
    }
}
