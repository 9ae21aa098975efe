//! A task for a built-in robot, planned and judged: the first byte says for which robot and how.
#![no_main]

use mcdpr::motion::PlanOptions;
use mcdpr::robot::BUILT_IN;
use mcdpr_tests::fuzz::planning::{Input, plan};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Some((&how, task)) = bytes.split_first() else {
        return;
    };
    let (_, robot) = BUILT_IN[usize::from(how >> 1) % BUILT_IN.len()];
    let _ = plan(&Input {
        robot: robot.to_owned(),
        task: String::from_utf8_lossy(task).into_owned(),
        is_gcode: how & 1 == 1,
        options: PlanOptions::default(),
        simulate: false,
    });
});
