//! A board in the loop: the emulated chip in another process, behind the three wires of a real one.

use mcdpr::experiment::{Experiment, SimulatedRobot, SimulatedRun};
use mcdpr::hil::Wires;
use mcdpr::machine::{Controller, Mismatch};
use mcdpr::motion::{Model, Task};
use mcdpr::robot::Robot;
use mcdpr_tests::chip::{LINE, firmware};
use mcdpr_tests::in_the_loop::Emulated;
use mcdpr_tests::mcdpr;
use mcdpr_tests::process::Folder;

fn model() -> Model {
    Model::new(&Robot::built_in("paper-table5").unwrap()).unwrap()
}

fn line(model: &Model, controller: &Controller) -> SimulatedRun {
    let robot = SimulatedRobot::new(Mismatch::realistic(), 5).controller(controller);
    let task = Task::parse(LINE, "line.toml".into()).unwrap();
    Experiment::new(model, task).simulate(&robot).unwrap()
}

#[test]
fn a_line_with_the_board_in_the_loop_has_the_figures_of_the_chip_in_this_process() {
    let model = model();
    let emulated = Emulated::start(None);
    let wires = Wires::parse(&emulated.on, 1.0).unwrap();
    let mut means = Vec::new();
    for controller in [Controller::Chip(firmware()), Controller::Hil(wires)] {
        let run = line(&model, &controller).run;
        let figures = run.figures(&model).unwrap();
        let (tool, tension) = (figures.path_error_m.unwrap(), figures.tension_error_n);
        println!(
            "tool {:.4} / {:.4} mm, tension {:.4} N",
            tool.mean * 1e3,
            tool.max * 1e3,
            tension.mean_abs
        );
        means.push([tool.mean, tension.mean_abs]);
    }
    // A slice is 250 us there and 50 us here: the board sees the plant up to 0.2 ms later.
    for (chip, looped) in means[0].into_iter().zip(means[1]) {
        assert!((looped / chip - 1.0).abs() < 0.08, "{means:?}");
    }
}

#[test]
fn two_runs_with_the_board_in_the_loop_are_alike_to_the_last_bit() {
    let model = model();
    let emulated = Emulated::start(None);
    let wires = Wires::parse(&emulated.on, 1.0).unwrap();
    let runs = [0, 1].map(|_| line(&model, &Controller::Hil(wires.clone())));
    assert_eq!(runs[0].run.samples, runs[1].run.samples);
}

/// What the program says of a run on these wires, which it refuses.
fn refused(folder: &Folder, robot: &str, on: &str) -> String {
    let output = mcdpr()
        .args(["run", "fitting", "--robot", robot, "--on", on])
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert!(!output.status.success(), "{on}");
    let said = String::from_utf8_lossy(&output.stderr).replace('│', "");
    said.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn wires_that_are_none_are_named() {
    let folder = Folder::new("hil-wires");
    let refused = |on: &str| refused(&folder, "paper-table5", on);
    let two = refused("hil:/dev/ttyUSB0,can0");
    assert!(two.contains("three wires are needed, not 2"), "{two}");
    let gone = refused("hil:/dev/nowhere,can0,/dev/nothing");
    assert!(gone.contains("signal board /dev/nothing"), "{gone}");
    let emulated = Emulated::start(None);
    let names = emulated.on.trim_start_matches("hil:");
    let [line, can, signals]: [&str; 3] = names.split(',').collect::<Vec<_>>().try_into().unwrap();
    let silent = refused(&format!("hil:{signals},{can},{line}"));
    assert!(silent.contains("does not answer the greeting"), "{silent}");
    let bus = refused(&format!("hil:{line},nocan7,{signals}"));
    assert!(bus.contains("CAN nocan7"), "{bus}");
    let eight = self::refused(&folder, "eight-cable", &emulated.on);
    assert!(eight.contains("drives 4 cables"), "{eight}");
}

#[test]
fn a_board_that_goes_while_the_robot_moves_ends_the_run() {
    let model = model();
    let mut emulated = Some(Emulated::start(None));
    let wires = Wires::parse(&emulated.as_ref().unwrap().on, 1.0).unwrap();
    let robot = SimulatedRobot::new(Mismatch::realistic(), 5).controller(&Controller::Hil(wires));
    let task = Task::parse(LINE, "line.toml".into()).unwrap();
    // Called while the robot moves.
    let run = Experiment::new(&model, task).progress(|_| drop(emulated.take()));
    let error = run.simulate(&robot).unwrap_err().to_string();
    assert!(error.contains("signal board"), "{error}");
}
