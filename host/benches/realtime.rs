//! How much faster than real time the simulated robot runs: control core at 1 kHz, plant at
//! 10 kHz, client, wire and telemetry included, on one core.

use criterion::{Criterion, criterion_group, criterion_main};
use mcdpr::experiment::{Experiment, SimulatedRobot};
use mcdpr::machine::Mismatch;
use mcdpr::motion::path::Path;
use mcdpr::motion::{Model, Plan, Step, Task};
use mcdpr::robot::Robot;
use std::hint::black_box;
use std::time::{Duration, Instant};

fn circle(criterion: &mut Criterion) {
    let robot = Robot::built_in("paper-optimistic").expect("a built-in robot");
    let model = Model::new(&robot).expect("three cables are held by length");
    let run = || {
        let task = Task::built_in("paper:table7", -0.18).expect("a built-in task");
        Experiment::new(&model, task)
            .simulate(&SimulatedRobot::new(Mismatch::realistic(), 1))
            .expect("it runs")
    };
    let plan = || {
        let task = Task::built_in("paper:table7", -0.18).expect("a built-in task");
        Experiment::new(&model, task)
            .plan()
            .expect("it is feasible")
    };
    // The planner's share, so that the simulator's own factor can be separated.
    let timed = |work: &dyn Fn()| {
        let began = Instant::now();
        work();
        began.elapsed()
    };
    let runs: Vec<_> = (0..5).map(|_| run()).collect();
    let planning = (0..5).map(|_| timed(&|| drop(black_box(plan())))).min();
    let fastest = runs
        .iter()
        .map(|run| run.took)
        .min()
        .unwrap_or(Duration::MAX);
    let simulated_s = runs.first().map_or(0.0, |run| run.simulated_s);
    let simulating = fastest.saturating_sub(planning.unwrap_or_default());
    println!(
        "real time ratio: {:.0} with planning, {:.0} simulated seconds per second without \
         ({simulated_s:.1} s in {:.3} s, {:.3} s of it planning)",
        simulated_s / fastest.as_secs_f64(),
        simulated_s / simulating.as_secs_f64(),
        fastest.as_secs_f64(),
        planning.unwrap_or_default().as_secs_f64(),
    );
    // A minute of lines: what a task of 60 s takes to plan.
    let minute = || {
        let z_m = -0.18;
        let corner = |x: f64, y: f64| nalgebra::Vector3::new(x, y, z_m);
        let corners = [
            corner(0.255, -0.105),
            corner(0.415, -0.105),
            corner(0.415, 0.105),
            corner(0.255, 0.105),
            corner(0.255, -0.105),
        ];
        let mut points = vec![corners[0]];
        for _ in 0..3 {
            points.extend(corners.iter().skip(1));
        }
        let steps: Vec<_> = points
            .windows(2)
            .map(|pair| Step::Move {
                path: Path::through(pair).expect("two places"),
                duration_s: Some(5.0),
                speed_mps: None,
            })
            .collect();
        Plan::new(&model, &corners[0], &steps).expect("it is feasible")
    };
    let took = (0..5).map(|_| timed(&|| drop(black_box(minute())))).min();
    println!(
        "planning {:.0} s of lines takes {:.3} s",
        minute().timed.duration_s(),
        took.unwrap_or_default().as_secs_f64()
    );
    let mut group = criterion.benchmark_group("table 7");
    group.sample_size(10);
    group.bench_function("plan", |bencher| bencher.iter(plan));
    group.bench_function("plan and simulate", |bencher| bencher.iter(run));
    group.finish();
}

criterion_group!(benches, circle);
criterion_main!(benches);
