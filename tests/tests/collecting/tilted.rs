//! An inclinometer on the platform: `collect` reads it at every pose, and the calibration finds how it is mounted.

use crate::{folder, options, run, with_board};
use mcdpr::calibration::collect::{Step, collect};
use mcdpr::calibration::general::Set;
use mcdpr::calibration::{Data, Options as Estimator, joint};
use mcdpr::experiment::SimulatedRobot;
use mcdpr::machine::Mismatch;
use mcdpr::motion::Model;
use mcdpr::robot::{Imu, Robot};
use mcdpr::sight::{Scene, SightError, SimulatedTags, SimulatedTilt, TiltSource, WithTilt};
use nalgebra::Vector3;

const NOISE_RAD: f64 = 9e-4;

fn with_imu() -> Robot {
    let mut robot = with_board("paper-table5");
    robot.imu = Some(Imu {
        noise_rad: NOISE_RAD,
        baud: 115_200,
    });
    robot
}

/// Data of a simulated robot, and how its inclinometer is truly mounted.
fn collected(seed: u64) -> (Data, Vector3<f64>) {
    let robot = with_imu();
    let model = Model::new(&robot).unwrap();
    let link = SimulatedRobot::new(Mismatch::as_built(), seed)
        .at_home(&model)
        .unwrap();
    let tags = SimulatedTags::new(link.clone(), Scene::of(&robot, seed), 0.1, seed);
    let tilt = SimulatedTilt::new(link.clone(), NOISE_RAD, seed);
    let mount = tilt.mount_rad();
    let mut source = WithTilt { tags, tilt };
    let mut shown = 0;
    let progress = |step: Step| {
        if let Step::Measured { tilt_rad, .. } = step {
            shown += usize::from(tilt_rad.is_some());
        }
    };
    let options = options(12, seed);
    let data = collect(
        &model,
        link,
        &mut source,
        &options,
        None,
        |_| Ok(()),
        progress,
    )
    .unwrap();
    assert_eq!(shown, 11);
    (data, mount)
}

#[test]
fn its_mounting_is_found_and_a_wrong_reading_is_named() {
    let (data, mount) = collected(11);
    assert!(data.poses.iter().all(|pose| pose.tilt_rad.is_some()));
    assert_eq!(data.noise.tilt_rad, Some(NOISE_RAD));
    // As the file has it.
    let mut data = Data::from_json(&data.to_json().to_string()).unwrap();
    // The other estimator, which looks for slips, has them too.
    let set = Set::from_data(&data).unwrap();
    let [roll, pitch, yaw] = set.samples[1].rpy_rad;
    assert_eq!([roll, pitch], data.poses[1].tilt_rad.unwrap().map(Some));
    assert_eq!(yaw, None);
    let answer = joint(&data, &Estimator::default()).unwrap();
    let found = answer.further.as_ref().unwrap().mount_rad.unwrap();
    // About the vertical it shows only where the platform tilts.
    let off = found - mount;
    assert!(off.xy().norm() < 2e-3, "{off}");
    assert!(off.z.abs() < 0.02, "{off}");
    let degrees = answer.to_json()["inclinometer_mount_deg"].clone();
    assert!((degrees[0].as_f64().unwrap() - found.x.to_degrees()).abs() < 1e-12);

    data.poses[4].tilt_rad.as_mut().unwrap()[0] += 0.1;
    let answer = joint(&data, &Estimator::default()).unwrap();
    let named = answer
        .rejected
        .iter()
        .any(|row| row.pose == 5 && row.kind == "tilt");
    assert!(named, "{:?}", answer.rejected);
    let again = answer.further.as_ref().unwrap().mount_rad.unwrap();
    assert!((again - found).xy().norm() < 1e-3, "{again}");
}

/// A sensor that is unplugged.
struct Unplugged;

impl TiltSource for Unplugged {
    fn read_rad(&mut self) -> Result<Option<[f64; 2]>, SightError> {
        Err(SightError::NoTilt {
            what: "the port was closed".to_owned(),
        })
    }
}

#[test]
fn one_that_is_unplugged_ends_the_collection() {
    let robot = with_imu();
    let model = Model::new(&robot).unwrap();
    let link = SimulatedRobot::new(Mismatch::as_built(), 3)
        .at_home(&model)
        .unwrap();
    let tags = SimulatedTags::new(link.clone(), Scene::of(&robot, 3), 0.1, 3);
    let mut source = WithTilt {
        tags,
        tilt: Unplugged,
    };
    let ended = collect(
        &model,
        link.clone(),
        &mut source,
        &options(12, 3),
        None,
        |_| Ok(()),
        |_| {},
    );
    let error = ended.unwrap_err().to_string();
    assert!(error.contains("inclinometer"), "{error}");
    // The brakes hold it.
    assert!(link.with(|s| {
        s.plant().truth().unwrap().brakes_closed[..4]
            .iter()
            .all(|c| *c)
    }));
}

#[test]
fn one_that_cannot_be_meant_is_refused_before_anything_moves() {
    let folder = folder("imu");
    let own = folder.join("own.toml");
    let built_in = include_str!("../../../robots/paper-table5.toml");
    std::fs::write(&own, format!("{built_in}\n[imu]\nkind = \"serial\"\n")).unwrap();
    let own = own.display().to_string();
    let collect = ["calibrate", "collect", "--imu", "/dev/null", "--robot"];
    let refused = [
        (vec![own.as_str()], "has its own inclinometer"),
        (vec!["paper-table5", "--on", "/dev/none"], "no inclinometer"),
    ];
    for (words, reason) in refused {
        let (code, _, said) = run(&folder, &[&collect, words.as_slice()].concat());
        assert_eq!(code, Some(1), "{words:?}: {said}");
        assert!(said.contains(reason), "{words:?}: {said}");
    }
}
