//! Slow physics, and the plant at rest against the plant that moves.

use super::*;
use crate::plant::day::{DayHold, DayPlant};

/// The requirement: 0.02 mm between both plants.
const SAME_M: f64 = 2e-5;

/// The paper's robot, its swing damped, with creep that is over within seconds.
fn slow_robot(loss: f64) -> PlantParams {
    let mut params = PlantParams::paper_optimistic();
    params.platform.linear_damping_ns_per_m = 1.4 * 12.0;
    params.platform.angular_damping_nms = 0.05;
    for cable in &mut params.cables {
        cable.pulley_loss = loss;
    }
    let mut creep = Creep::polymer(0.003, 10.0, 50_000.0);
    creep.elements[0].retardation_s = 1.0;
    creep.elements[1].retardation_s = 4.0;
    params.slow = SlowParams {
        creep: vec![creep; 4],
        frame_expansion_per_k: 23e-6,
        frame_center_m: [0.3, 0.0, 0.0],
        cable_expansion_per_k: -12e-6,
        warming: Warming::default(),
    };
    params
}

const LOAD: Payload = Payload {
    mass_kg: 0.7,
    center_m: [0.012, -0.008, -0.1],
};

fn tool_of(plant: &Plant) -> [f64; 3] {
    plant.truth().expect("a path").tool_position_m
}

fn let_pass(day: &mut DayPlant, seconds: f64) {
    let holds = [DayHold::Drum(0.0); 4];
    for _ in 0..(seconds * 20.0) as usize {
        day.rest(&holds).expect("it hangs");
        day.pass(0.05);
    }
    day.rest(&holds).expect("it hangs");
}

#[test]
fn a_resting_plant_hangs_like_one_that_moves_under_load_creep_and_heat() {
    for loss in [0.0, 0.02] {
        let mut moving = at_rest(slow_robot(loss), &off_centre(), 8.0);
        let mut day = DayPlant::of(&moving);
        let start = tool_of(&moving);
        moving.carry(Some(&LOAD)).expect("a load");
        moving.warm(5.0, 5.0).expect("a temperature");
        day.carry(Some(&LOAD)).expect("a load");
        day.warm(5.0, 5.0);
        let mut way = 0.0_f64;
        for _ in 0..2 {
            // Five times the slowest retardation: both are at rest.
            moving.advance(20.0).expect("it hangs");
            let_pass(&mut day, 20.0);
            let (a, b) = (tool_of(&moving), day.state().tool_position_m);
            println!("loss {loss}: {:.2e} mm apart", distance(a, b) * 1e3);
            assert!(distance(a, b) < SAME_M, "loss {loss}: {a:?} {b:?}");
            way = way.max(distance(a, start));
        }
        // Load, creep and heat move it by millimetres: agreement means something.
        assert!(way > 2e-3, "{way}");
        // Set down: it recovers, and both plants agree on how far.
        moving.carry(None).expect("none");
        day.carry(None).expect("none");
        moving.advance(20.0).expect("it hangs");
        let_pass(&mut day, 20.0);
        let (a, b) = (tool_of(&moving), day.state().tool_position_m);
        assert!(
            distance(a, b) < SAME_M,
            "set down, loss {loss}: {a:?} {b:?}"
        );
    }
}

#[test]
fn creep_comes_under_load_and_goes_without() {
    let creep = Creep::polymer(0.003, 10.0, 50_000.0);
    let mut params = PlantParams::paper_optimistic();
    params.slow.creep = vec![creep; 4];
    let mut plant = at_rest(params, &off_centre(), 8.0);
    let tension = plant.truth().expect("a path").tensions_platform_n[0];
    let mut slow = plant.slow.clone();
    let end = (creep.elements[0].compliance + creep.elements[1].compliance) * tension / 50_000.0;
    // Five-element model: e1 (1 - exp(-t / 300 s)) + e2 (1 - exp(-t / 7200 s)), by hand after an hour.
    slow.pass(&mut plant.cables, 3600.0);
    let by_hand = end * (0.4 * (1.0 - (-12.0_f64).exp()) + 0.6 * (1.0 - (-0.5_f64).exp()));
    assert!((slow.strain(0) - by_hand).abs() < 1e-12);
    slow.pass(&mut plant.cables, 1e6);
    assert!((slow.strain(0) - end).abs() < 1e-12 && end > 5e-4);
    plant.cables[0].tension = Tension::default();
    slow.pass(&mut plant.cables, 1e6);
    assert!(slow.strain(0).abs() < 1e-12);
}

#[test]
fn each_slow_part_has_its_own_switch() {
    let holds = [DayHold::Drum(0.0); 4];
    let still = |change: fn(&mut SlowParams)| {
        let mut params = slow_robot(0.0);
        change(&mut params.slow);
        let moving = at_rest(params, &off_centre(), 8.0);
        let mut day = DayPlant::of(&moving);
        let from = day.state().tool_position_m;
        day.warm(5.0, 0.0);
        day.rest(&holds).expect("it hangs");
        let frame = distance(day.state().tool_position_m, from);
        day.warm(0.0, 5.0);
        day.rest(&holds).expect("it hangs");
        let cable = distance(day.state().tool_position_m, from);
        day.warm(0.0, 0.0);
        day.pass(10.0);
        day.rest(&holds).expect("it hangs");
        [frame, cable, distance(day.state().tool_position_m, from)]
    };
    let nothing = 1e-8;
    for (part, off) in [
        (
            0,
            (|s| s.frame_expansion_per_k = 0.0) as fn(&mut SlowParams),
        ),
        (1, |s| s.cable_expansion_per_k = 0.0),
        (2, |s| s.creep.clear()),
    ] {
        let all = still(|_| {});
        let less = still(off);
        for k in 0..3 {
            assert!(all[k] > 1e-5, "{all:?}");
            assert_eq!(less[k] < nothing, k == part, "part {part}: {less:?}");
        }
    }
}

#[test]
fn a_bad_load_is_refused_and_nothing_moves() {
    let mut plant = at_rest(slow_robot(0.0), &off_centre(), 8.0);
    let before = tool_of(&plant);
    for load in [
        Payload {
            mass_kg: 0.0,
            ..LOAD
        },
        Payload {
            mass_kg: f64::NAN,
            ..LOAD
        },
        Payload {
            center_m: [f64::INFINITY, 0.0, 0.0],
            ..LOAD
        },
    ] {
        assert!(plant.carry(Some(&load)).is_err());
    }
    assert!(plant.warm(f64::NAN, 0.0).is_err());
    assert!(plant.knock_anchor(4, [0.0; 3]).is_err());
    assert_eq!(before, tool_of(&plant));
}

#[test]
fn a_tension_that_is_held_gives_way() {
    let moving = at_rest(slow_robot(0.02), &off_centre(), 8.0);
    let mut day = DayPlant::of(&moving);
    let drum = DayHold::Drum(0.0);
    day.rest(&[drum, drum, drum, DayHold::Tension(9.0)])
        .expect("it hangs");
    let state = day.state();
    assert!((state.tensions_winch_n[3] - 9.0).abs() < 1e-6);
    assert!(
        state.drum_positions_m[3] < 0.0,
        "hauled in for more tension"
    );
    // A tension that pulls the platform off its other cables is refused, and the state stays.
    let before = day.state();
    assert!(
        day.rest(&[drum, drum, drum, DayHold::Tension(4000.0)])
            .is_err()
    );
    assert_eq!(before, day.state());
}

/// Friction that turns moves the cable of a held tension back, so that friction and rest have to be found together.
#[test]
fn friction_and_rest_agree_where_a_tension_is_held() {
    // A sharp pulley: its friction moves the cable by more than its travel.
    let mut params = slow_robot(0.02);
    let presliding_m = 2e-5;
    params.cables[3].pulley_presliding_m = presliding_m;
    let moving = at_rest(params, &off_centre(), 8.0);
    let mut day = DayPlant::of(&moving);
    let friction = |state: &crate::plant::DayState| {
        (state.tensions_winch_n[3] / state.tensions_platform_n[3] - 1.0) / 0.02
    };
    let passed_m = |state: &crate::plant::DayState| {
        state.drum_positions_m[3]
            + state.tensions_winch_n[3] * moving.params.cables[3].routing_length_m
                / moving.params.cables[3].ea_n
    };
    let start = day.state();
    let (mut side, mut at_m) = (friction(&start), passed_m(&start));
    let mut turned = 0;
    for k in 0..300_i32 {
        // The other drums wander by a hundredth of a millimetre, the held tension by a tenth of a newton.
        let by = |share: f64| 1e-5 * (f64::from(k) * share).sin();
        let drums = [by(0.7), by(1.1), by(1.7)].map(DayHold::Drum);
        let held = DayHold::Tension(8.0 + 0.1 * (f64::from(k) * 2.3).sin());
        day.rest(&[drums[0], drums[1], drums[2], held])
            .expect("it hangs");
        let state = day.state();
        // Dahl's law by hand, along the way that the cable went.
        let way_m = at_m - passed_m(&state);
        at_m = passed_m(&state);
        let end = way_m.signum();
        turned += i32::from(end * side < 0.0);
        side = end + (side - end) * (-way_m.abs() / presliding_m).exp();
        let found = friction(&state);
        assert!((found - side).abs() < 2e-3, "{k}: {found} {side}");
        side = found;
    }
    assert!(turned > 20, "friction turned {turned} times");
}

#[test]
fn a_plant_warms_up_and_its_sensors_drift_by_themselves() {
    let mut params = slow_robot(0.0);
    params.slow.creep.clear();
    let warm = Warming {
        rise_k: 5.0,
        time_s: 2.0,
    };
    params.slow.warming = warm;
    let sensor = &mut params.winches[2].sensor;
    sensor.noise_n = 0.0;
    // A newton in ten seconds.
    sensor.drift.steady_n = 2880.0;
    let volts_per_n = 1.0 / sensor.gain_n_per_v;
    let mut by_itself = at_rest(params.clone(), &off_centre(), 8.0);
    params.slow.warming = Warming::default();
    params.winches[2].sensor.drift = SensorDrift::default();
    let mut by_hand = at_rest(params, &off_centre(), 8.0);
    by_hand.warm(5.0, 5.0).expect("a temperature");
    let start = tool_of(&by_itself);
    for plant in [&mut by_itself, &mut by_hand] {
        plant.advance(20.0).expect("it hangs");
    }
    // Ten times the time constant: as warm as by hand, and that moves the tool.
    let (a, b) = (tool_of(&by_itself), tool_of(&by_hand));
    assert!(distance(a, b) < 2e-6, "{a:?} {b:?}");
    assert!(distance(a, start) > 2e-5, "{a:?} {start:?}");
    // Sixteen conversions of twelve bits for 3.3 V.
    let read = |plant: &mut Plant| f64::from(plant.read_sensors().adc[2]) / 65_536.0 * 3.3;
    let more_n = (read(&mut by_itself) - read(&mut by_hand)) / volts_per_n;
    assert!((more_n - 2.0).abs() < 0.1, "{more_n}");
    let wave = SensorDrift {
        wave_n: 0.1,
        phase_rad: 1.0,
        ..SensorDrift::default()
    };
    assert!(wave.zero_n(0.0).abs() < 1e-15);
    // A quarter of the way to its crest and back: nine radians in eight hours.
    let crest_s = 28_800.0 / 9.0 * (std::f64::consts::FRAC_PI_2 - 1.0);
    assert!((wave.zero_n(crest_s) - 0.1 * (1.0 - 1.0_f64.sin())).abs() < 1e-12);
}
