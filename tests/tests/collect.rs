//! Collecting calibration data on the simulated robot, the file that comes of it, and the robot that
//! uses it. The simulated machine is as a workshop builds it: anchors off by up to 5 mm, pulleys that
//! lose 2 %, mass, stiffness, sensors and drives off (`Mismatch::as_built`).

mod collecting;

use mcdpr::calibration::collect::{CollectError, Options, Step, collect};
use mcdpr::calibration::data::View;
use mcdpr::calibration::{Data, Options as Estimator, joint, result, target};
use mcdpr::experiment::SimulatedRobot;
use mcdpr::link::SimulatedLink;
use mcdpr::machine::Mismatch;
use mcdpr::motion::Model;
use mcdpr::robot::Robot;
use mcdpr::run::RunError;
use mcdpr::sight::{Scene, SceneCamera, SightError, SimulatedTags, TagSource, TagView};
use mcdpr_protocol::SessionId;
use mcdpr_simulator::LinkOptions;
use mcdpr_simulator::camera::Frame as Place;
use mcdpr_tests::mcdpr;
use serde_json::Value;
use std::cell::{Cell, RefCell};
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// A folder of its own for one test.
fn folder(name: &str) -> PathBuf {
    let path = std::env::temp_dir().join(format!("mcdpr-collect-{}-{name}", std::process::id()));
    let _ = std::fs::remove_dir_all(&path);
    std::fs::create_dir_all(&path).unwrap();
    path
}

fn options(poses: usize, seed: u64) -> Options {
    Options {
        poses,
        candidates: 120,
        seed,
        simulated_seed: Some(seed),
        session: Some(SessionId(1)),
        ..Options::default()
    }
}

fn on_simulator(
    robot: &Robot,
    options: &Options,
    before: Option<Data>,
    keep: impl FnMut(&Data) -> Result<(), CollectError>,
    progress: impl FnMut(Step),
) -> Result<Data, CollectError> {
    let model = Model::new(robot)?;
    let link = SimulatedRobot::new(Mismatch::as_built(), options.seed).at_home(&model)?;
    let scene = Scene::of(robot, options.seed);
    let mut tags = SimulatedTags::new(link.clone(), scene, 0.1, options.seed);
    collect(&model, link, &mut tags, options, before, keep, progress)
}

fn with_board(name: &str) -> Robot {
    let mut robot = mcdpr::robot::find(name).unwrap();
    robot.tags = target::tags(mcdpr::calibration::simulate::Target::Board);
    robot
}

#[test]
fn collected_data_calibrate_the_robot() {
    let robot = Robot::built_in("paper-table5").unwrap();
    let mut steps = Vec::new();
    let data = on_simulator(&robot, &options(12, 7), None, |_| Ok(()), |s| steps.push(s)).unwrap();
    assert_eq!(data.poses.len(), 12);
    let measured = |step: &&Step| matches!(step, Step::Measured { .. });
    assert_eq!(steps.iter().filter(measured).count(), 11);
    let Some(Step::Returned { apart_m }) = steps.last() else {
        panic!("{:?}", steps.last());
    };
    assert!(*apart_m < 1e-3, "{apart_m}");
    let answer = joint(&data, &Estimator::default()).unwrap();
    assert!(
        answer.predicted_error_m < 2e-3,
        "{}",
        answer.predicted_error_m
    );
    assert!(answer.rejected.len() < 4, "{:?}", answer.rejected);
}

#[test]
fn a_stop_by_order_ends_the_collection_and_keeps_what_was_measured() {
    let robot = Robot::built_in("paper-table5").unwrap();
    let options = options(12, 7);
    let orders = options.orders.clone();
    let mut kept = 0;
    let stopped = on_simulator(
        &robot,
        &options,
        None,
        |data| {
            kept = data.poses.len();
            Ok(())
        },
        |step| {
            if matches!(step, Step::Going { done: 3, .. }) {
                orders.stop();
            }
        },
    );
    let error = stopped.unwrap_err();
    assert!(
        matches!(error, CollectError::Run(RunError::Interrupted)),
        "{error}"
    );
    assert_eq!(kept, 3);
}

#[test]
fn a_broken_off_collection_is_continued() {
    let robot = Robot::built_in("paper-table5").unwrap();
    let mut kept: Option<Data> = None;
    // The disk is full after the fifth pose.
    let broken = on_simulator(
        &robot,
        &options(9, 3),
        None,
        |data| {
            if data.poses.len() > 5 {
                return Err(CollectError::Impossible {
                    what: "disk full".into(),
                    help: String::new(),
                });
            }
            kept = Some(data.clone());
            Ok(())
        },
        |_| {},
    );
    assert!(broken.unwrap_err().to_string().contains("disk full"));
    let kept = kept.unwrap();
    assert_eq!(kept.poses.len(), 5);
    let whole = on_simulator(
        &robot,
        &options(9, 3),
        Some(kept.clone()),
        |_| Ok(()),
        |_| {},
    )
    .unwrap();
    assert_eq!(whole.poses.len(), 9);
    assert_eq!(whole.poses[..5], kept.poses[..]);
    assert!(joint(&whole, &Estimator::default()).is_ok());
    // Neither another robot's data nor another machine's are continued.
    let other = Robot::built_in("paper-table3").unwrap();
    let words = on_simulator(
        &other,
        &options(9, 3),
        Some(kept.clone()),
        |_| Ok(()),
        |_| {},
    );
    assert!(words.unwrap_err().to_string().contains("paper-table3"));
    let words = on_simulator(&robot, &options(9, 4), Some(kept), |_| Ok(()), |_| {});
    assert!(words.unwrap_err().to_string().contains("seed 3"));
}

#[test]
fn it_stops_when_the_expected_error_is_small_enough() {
    let mut wanted = options(30, 5);
    wanted.target_error_m = Some(1.5e-3);
    let mut last = f64::NAN;
    let data = on_simulator(
        &with_board("paper-table5"),
        &wanted,
        None,
        |_| Ok(()),
        |step| {
            if let Step::Measured {
                expected_error_m, ..
            } = step
            {
                last = expected_error_m;
            }
        },
    )
    .unwrap();
    assert!((7..30).contains(&data.poses.len()), "{}", data.poses.len());
    assert!(last < 1.5e-3, "{last}");
}

#[test]
fn a_target_out_of_view_is_named() {
    let robot = Robot::built_in("paper-table5").unwrap();
    let model = Model::new(&robot).unwrap();
    let link = SimulatedRobot::new(Mismatch::as_built(), 1).at_home(&model);
    let link = link.unwrap();
    let mut scene = Scene::of(&robot, 1);
    scene.places[0].world_from_body.position_m.x += 2.0;
    let mut tags = SimulatedTags::new(link.clone(), scene, 0.1, 1);
    let refused = collect(
        &model,
        link,
        &mut tags,
        &options(9, 1),
        None,
        |_| Ok(()),
        |_| {},
    );
    let words = refused.unwrap_err().to_string();
    assert!(words.contains("no known tag is in view"), "{words}");
}

/// A camera that loses its tags on the way to the third pose, and sees them 60 px off at the sixth.
struct Unreliable {
    tags: SimulatedTags,
    going: Rc<Cell<usize>>,
}

impl TagSource for Unreliable {
    fn look(&mut self) -> Result<Vec<TagView>, SightError> {
        let mut views = self.tags.look()?;
        match self.going.get() {
            3 => views.clear(),
            6 => {
                let corners = views.iter_mut().flat_map(|view| &mut view.corners_px);
                corners.for_each(|corner| corner[0] += 60.0);
            }
            _ => {}
        }
        Ok(views)
    }
}

#[test]
fn s12_lost_tags_cost_their_pose_and_a_wrong_sight_is_named_and_moves_nothing() {
    let robot = with_board("paper-table5");
    let model = Model::new(&robot).unwrap();
    let link = SimulatedRobot::new(Mismatch::as_built(), 6).at_home(&model);
    let link = link.unwrap();
    let going = Rc::new(Cell::new(0));
    let mut eye = Unreliable {
        tags: SimulatedTags::new(link.clone(), Scene::of(&robot, 6), 0.1, 6),
        going: going.clone(),
    };
    let mut skipped = Vec::new();
    let line = link.clone();
    let data = collect(
        &model,
        line,
        &mut eye,
        &options(12, 6),
        None,
        |_| Ok(()),
        |step| match step {
            Step::Going { .. } => going.set(going.get() + 1),
            Step::Skipped { reason } => skipped.push(reason),
            Step::Measured { .. } | Step::Returned { .. } => {}
        },
    )
    .unwrap();
    // The pose without tags is left out and made up for; the robot went on from its lengths.
    assert_eq!(skipped.len(), 1, "{skipped:?}");
    assert!(skipped[0].contains("tag"), "{skipped:?}");
    assert_eq!(data.poses.len(), 12);
    assert_eq!(link.with(|simulation| simulation.fault()), None);
    // The wrong sight is named, and the answer is that of the data without it.
    let with = joint(&data, &Estimator::default()).unwrap();
    assert!(with.rejected.len() >= 4, "{:?}", with.rejected);
    let mut without = data.clone();
    // The third gave nothing: the sixth on its way is the fifth in the data.
    without.poses.remove(4);
    let without = joint(&without, &Estimator::default()).unwrap();
    for (a, b) in with.cables.iter().zip(&without.cables) {
        let apart_m = (a.anchor_m - b.anchor_m).norm();
        assert!(apart_m < 1e-3, "{apart_m} m");
    }
}

/// A camera that sees its tags from home, and never again.
struct Blinded {
    tags: SimulatedTags,
    going: Rc<Cell<usize>>,
}

impl TagSource for Blinded {
    fn look(&mut self) -> Result<Vec<TagView>, SightError> {
        let views = self.tags.look()?;
        Ok(if self.going.get() > 0 {
            Vec::new()
        } else {
            views
        })
    }
}

#[test]
fn poses_that_all_give_nothing_end_it_and_the_robot_goes_home() {
    let robot = with_board("paper-table5");
    let model = Model::new(&robot).unwrap();
    let built = Mismatch::as_built();
    let link = SimulatedRobot::new(built, 4).at_home(&model).unwrap();
    let going = Rc::new(Cell::new(0));
    let mut eye = Blinded {
        tags: SimulatedTags::new(link.clone(), Scene::of(&robot, 4), 0.1, 4),
        going: going.clone(),
    };
    let line = link.clone();
    let progress = |step| going.set(going.get() + usize::from(matches!(step, Step::Going { .. })));
    let keep = |_: &Data| Ok(());
    let ended = collect(
        &model,
        line,
        &mut eye,
        &options(12, 4),
        None,
        keep,
        progress,
    );
    let words = ended.unwrap_err().to_string();
    assert!(words.contains("8 poses one after another"), "{words}");
    assert_eq!(going.get(), 8);
    let home = model.rest_at_home().unwrap().equilibrium.pose.position_m;
    let truth = link.with(|simulation| simulation.plant().truth()).unwrap();
    let off_m = (0..3).map(|k| (truth.pose.position_m[k] - home[k]).powi(2));
    // Anchors are off by 5 mm.
    assert!(off_m.sum::<f64>().sqrt() < 0.02);
    assert_eq!(link.with(|simulation| simulation.fault()), None);
}

/// Runs the program in a folder and gives exit code, standard output and standard error.
fn run(folder: &Path, args: &[&str]) -> (Option<i32>, String, String) {
    let output = mcdpr().current_dir(folder).args(args).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (
        output.status.code(),
        text(&output.stdout),
        text(&output.stderr),
    )
}

fn path_error_m(folder: &Path, more: &[&str]) -> (f64, f64) {
    let mut args = vec!["run", "paper:table7", "--json"];
    args.extend(more);
    let (code, out, err) = run(folder, &args);
    assert_eq!(code, Some(0), "{err}");
    // Without it the machine would be another, and nearly as good.
    assert!(err.contains("calibration.json applied"), "{err}");
    let summary: Value = serde_json::from_str(&out).unwrap();
    let part = |key: &str| summary["path_error_m"][key].as_f64().unwrap();
    (part("mean"), part("max"))
}

/// Corners by projection while the platform comes to rest, and where it was meanwhile.
struct Watching {
    tags: SimulatedTags,
    link: SimulatedLink,
    seen: Rc<RefCell<Vec<Place>>>,
}

impl TagSource for Watching {
    fn look(&mut self) -> Result<Vec<TagView>, SightError> {
        let truth = self.link.with(|simulation| simulation.plant().truth());
        self.seen.borrow_mut().push(truth.unwrap().pose.into());
        self.tags.look()
    }
}

/// The middle of the last places; a Hann window leaves out what swings.
fn middle(places: &[Place]) -> Place {
    let last = &places[places.len().saturating_sub(75)..];
    let mut sum = [0.0; 12];
    let mut total = 0.0;
    for (k, place) in last.iter().enumerate() {
        let phase = std::f64::consts::TAU * (k as f64 + 0.5) / last.len() as f64;
        let weight = 1.0 - phase.cos();
        total += weight;
        let values = place.rotation.iter().flatten().chain(&place.position_m);
        for (slot, value) in sum.iter_mut().zip(values) {
            *slot += weight * value;
        }
    }
    // It swings by less than a milliradian: the mean of the matrices is one, to the square of that.
    let mean = sum.map(|value| value / total);
    Place {
        rotation: [0, 3, 6].map(|row| [mean[row], mean[row + 1], mean[row + 2]]),
        position_m: [mean[9], mean[10], mean[11]],
    }
}

/// From pictures to a calibrated robot: one of each place, rendered with blur, noise and shadow; the
/// tags are found in it, and the robot that follows from them goes where it should.
#[test]
fn pictures_calibrate_a_robot() {
    const SEED: u64 = 5;
    let folder = folder("pictures");
    let robot = with_board("paper-table5");
    let model = Model::new(&robot).unwrap();
    let (built, on) = (Mismatch::as_built(), LinkOptions::default());
    let link = SimulatedRobot::new(built, SEED)
        .line(on)
        .at_home(&model)
        .unwrap();
    let scene = Scene::of(&robot, SEED);
    let mut camera = SceneCamera::new(scene.clone(), SEED);
    let places = Rc::new(RefCell::new(Vec::new()));
    let mut eye = Watching {
        tags: SimulatedTags::new(link.clone(), scene, 0.1, SEED),
        link: link.clone(),
        seen: places.clone(),
    };
    let mut found = Vec::new();
    let options = Options {
        described: Some(Robot::built_in("paper-table5").unwrap().content_hash()),
        ..options(12, SEED)
    };
    let photograph = |data: &Data| {
        let picture = camera.picture(&middle(&places.take())).unwrap();
        let views = camera.tags(&picture, 0).into_iter().filter_map(|view| {
            Some(View {
                tag: data.tags.iter().position(|tag| tag.id == view.id)?,
                corners_px: view.corners_px,
            })
        });
        found.push(views.collect::<Vec<_>>());
        Ok(())
    };
    let line = link;
    let mut data = collect(&model, line, &mut eye, &options, None, photograph, |_| ()).unwrap();
    assert_eq!(data.poses.len(), found.len());
    // A tag at the picture's edge has no white rim there: it is projected, and not found.
    let projected: usize = data.poses.iter().map(|pose| pose.views.len()).sum();
    let seen: usize = found.iter().map(Vec::len).sum();
    println!("{seen} tags found, {projected} in view");
    assert!(10 * seen > 8 * projected, "{seen} of {projected}");
    for (pose, views) in data.poses.iter_mut().zip(found) {
        pose.views = views;
    }
    // Collecting by such a camera would have left out a place that shows nothing.
    data.poses.retain(|pose| !pose.views.is_empty());
    assert!(data.poses.len() >= 10, "{}", data.poses.len());
    // What the detector is good for in one picture (docs/vision.md).
    data.noise.corner_px = 0.05;
    let text = serde_json::to_string(&data.to_json()).unwrap();
    std::fs::write(folder.join("data.json"), text).unwrap();
    let solve = ["calibrate", "all", "--data", "data.json", "--json"];
    let (code, out, err) = run(&folder, &solve);
    assert_eq!(code, Some(0), "{err}");
    let answer: Value = serde_json::from_str(&out).unwrap();
    let expected_mm = answer["predicted_tcp_error_mm"].as_f64().unwrap();
    let (mean, max) = path_error_m(&folder, &["--seed", "5"]);
    println!("expected {expected_mm} mm; {mean} {max} m");
    // Its anchors were off by up to 5 mm; one picture a place, where collecting takes dozens.
    assert!(expected_mm < 0.8, "{out}");
    assert!(mean < 6e-4 && max < 9e-4, "{mean} {max}");
    std::fs::remove_dir_all(folder).unwrap();
}

/// The same four winch modules and the same platform on a frame of other dimensions: one file is
/// written, one command finds the frame, and the robot tracks as the first one does.
#[test]
fn a_reassembled_robot_tracks_as_before() {
    let folder = folder("reassembly");
    let old = std::fs::read_to_string(format!(
        "{}/../robots/paper-table5.toml",
        env!("CARGO_MANIFEST_DIR")
    ))
    .unwrap();
    std::fs::write(folder.join("old.toml"), &old).unwrap();
    // The new frame is 80 mm longer and 60 mm narrower, as measured with a tape.
    let new = old
        .replace("name = \"paper-table5\"", "name = \"reassembled\"")
        .replace("[25.102, -370.603, 24.1]", "[-15, -340, 30]")
        .replace("[40.201, 384.903, 24.2]", "[0, 355, 30]")
        .replace("[644.503, 370.101, 24.5]", "[685, 340, 30]")
        .replace("[629.502, -385.401, 23.9]", "[670, -355, 30]");
    assert_ne!(old, new);
    std::fs::write(folder.join("new.toml"), new).unwrap();
    let mut figures = Vec::new();
    for (robot, seed) in [("old.toml", "11"), ("new.toml", "12")] {
        let command = ["calibrate", "frame", "--target", "board", "--robot", robot];
        let more = [
            "--poses",
            "14",
            "--candidates",
            "150",
            "--seed",
            seed,
            "--json",
        ];
        let (code, out, err) = run(&folder, &[&command[..], &more[..]].concat());
        assert_eq!(code, Some(0), "{err}");
        let answer: Value = serde_json::from_str(&out).unwrap();
        assert!(
            answer["predicted_tcp_error_mm"].as_f64().unwrap() < 0.8,
            "{out}"
        );
        assert!(
            folder
                .join(robot.replace("toml", "calibration.json"))
                .is_file()
        );
        figures.push(path_error_m(&folder, &["--robot", robot]));
    }
    let [(old_mean, old_max), (new_mean, new_max)] = figures[..] else {
        panic!("two robots");
    };
    println!("old {old_mean} {old_max}, new {new_mean} {new_max}");
    // The figures of a machine whose anchors are off by 0.3 mm.
    assert!(old_mean < 4e-4 && new_mean < 4e-4, "{old_mean} {new_mean}");
    assert!(old_max < 9e-4 && new_max < 9e-4, "{old_max} {new_max}");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn f8_f9_a_calibration_is_kept_whole_and_used_only_where_it_belongs() {
    let folder = folder("kept");
    let robot = Robot::built_in("paper-table5").unwrap();
    let data = on_simulator(&robot, &options(10, 2), None, |_| Ok(()), |_| {}).unwrap();
    let data_file = folder.join("data.json");
    std::fs::write(&data_file, data.to_json().to_string()).unwrap();
    let (code, _, err) = run(&folder, &["calibrate", "all", "--data", "data.json"]);
    assert_eq!(code, Some(0), "{err}");
    let file = folder.join("paper-table5.calibration.json");
    let first = std::fs::read_to_string(&file).unwrap();
    let kept: Value = serde_json::from_str(&first).unwrap();
    for key in ["date", "data_hash", "robot_hash"] {
        assert!(
            kept[key].as_str().is_some_and(|text| text.len() >= 8),
            "{key}"
        );
    }
    assert_eq!(
        kept["covariance_of_shared_unknowns_si"]
            .as_array()
            .unwrap()
            .len(),
        71
    );
    // The robot that it makes.
    let applied = result::apply(&robot, &file).unwrap();
    let calibrated = applied.calibrated.as_ref().unwrap();
    assert_eq!(calibrated.simulated_seed, Some(2));
    assert_ne!(applied.content_hash(), robot.content_hash());
    // Another description refuses it, and so does a board for one of the simulator.
    let (code, _, err) = run(
        &folder,
        &[
            "run",
            "paper:table7",
            "--robot",
            "lab-fast",
            "--calibration",
            "paper-table5.calibration.json",
        ],
    );
    assert_eq!(code, Some(1));
    assert!(err.contains("belongs to robot"), "{err}");
    let (code, _, err) = run(&folder, &["run", "paper:table7", "--on", "/dev/null"]);
    assert_eq!(code, Some(1));
    assert!(err.contains("made on the simulator"), "{err}");
    // Data of another robot give no result for this one.
    let (code, _, err) = run(
        &folder,
        &[
            "calibrate",
            "all",
            "--data",
            "data.json",
            "--robot",
            "lab-fast",
        ],
    );
    assert_eq!(code, Some(1));
    assert!(err.contains("lab-fast"), "{err}");
    // Where nothing can be written, the old calibration stays as it was.
    let output = std::process::Command::new("sh")
        .args([
            "-c",
            "ulimit -f 0; exec \"$MCDPR\" calibrate all --data data.json",
        ])
        .env("MCDPR", mcdpr().get_program())
        .current_dir(&folder)
        .output()
        .unwrap();
    let err = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{err}");
    assert!(err.contains("older calibration is as it was"), "{err}");
    assert_eq!(std::fs::read_to_string(&file).unwrap(), first);
    std::fs::remove_dir_all(folder).unwrap();
}
