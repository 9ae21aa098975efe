//! A line so slow that every request is sent again before its answer is there.

use mcdpr_core::link::Client;
use mcdpr_core::motion::Model;
use mcdpr_core::robot::Robot;
use mcdpr_core::run;
use mcdpr_protocol::{BoardState, SessionId, StopKind};
use mcdpr_simulator::LinkOptions;
use mcdpr_twin::SimulatedLink;
use mcdpr_twin::line::in_process;
use mcdpr_twin::plant::{Mismatch, at_rest};

/// Stops and queries are besides the sequence. The second answer to a stop is not the answer to the query after it: a board
/// that has stopped would seem to have just started, without its fault and without a configuration.
#[test]
fn a_late_second_answer_is_none_to_the_next_request() {
    let robot = Robot::built_in("paper-table5").unwrap();
    let model = Model::new(&robot).unwrap();
    // 40 ms there and back; a host asks again after 30 ms.
    let line = LinkOptions {
        latency_us: 20_000,
        ..LinkOptions::default()
    };
    let plant = at_rest(&model, &robot, &Mismatch::default(), 1, None).unwrap();
    let link = SimulatedLink::timed(&robot, plant, &line, 1, &in_process, &[]).unwrap();
    let mut client = Client::connect(link, SessionId(1)).unwrap();
    let hash = run::configure(&mut client, &robot).unwrap();
    for kind in [StopKind::Stop, StopKind::Emergency] {
        client.stop(kind).unwrap();
        let status = run::status(&mut client).unwrap();
        assert_ne!(status.state, BoardState::Boot, "{kind:?}");
        assert_eq!(status.config, Some(hash), "{kind:?}");
        assert!(status.tick.0 > 0 && status.lengths_m().count() == 4);
    }
}
