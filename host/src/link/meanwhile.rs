//! Work that takes longer than a board waits for its host, on a separate thread.

use super::{Client, ClientError, Link};

/// Work that takes longer than this is assumed to hang: the board is left to hold by itself, µs.
const WORK_US: u64 = 60_000_000;
/// Polling interval for the end of the work, µs.
const WORK_LOOK_US: u64 = 2_000;

/// Runs work that takes longer than a board waits for its host. The work runs on another thread
/// while this one keeps the connection alive, for a minute at most; in virtual time it is simply
/// executed.
///
/// # Errors
/// As [`Client::pump`], when the work is done.
///
/// # Panics
/// If the work panics.
pub(crate) fn meanwhile<L: Link, T: Send>(
    client: &mut Client<L>,
    work: impl FnOnce() -> T + Send,
) -> Result<T, ClientError> {
    if !client.goes_on() {
        return Ok(work());
    }
    let begun_us = client.now_us();
    std::thread::scope(|scope| {
        let worker = scope.spawn(work);
        while !worker.is_finished() && client.now_us() < begun_us + WORK_US {
            client.pump(client.now_us() + WORK_LOOK_US)?;
        }
        match worker.join() {
            Ok(done) => Ok(done),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::{LinkError, SimulatedLink};
    use crate::machine::Mismatch;
    use crate::motion::Model;
    use crate::robot::Robot;
    use mcdpr_protocol::{BoardState, SessionId};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::time::{Duration, Instant};

    /// Time between heartbeats, µs.
    const BEAT_US: u64 = 8_000;

    /// A simulated robot whose time goes on, as a port's does, and what was sent to it.
    struct Live(SimulatedLink, Arc<AtomicU64>);

    impl Link for Live {
        fn now_us(&self) -> u64 {
            self.0.now_us()
        }
        fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
            self.1.fetch_add(1, Ordering::Relaxed);
            self.0.send(bytes)
        }
        fn receive(&mut self, until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
            self.0.receive(until_us, into)
        }
        fn goes_on(&self) -> bool {
            true
        }
    }

    #[test]
    fn a_board_hears_its_host_while_the_host_works() {
        let model = Model::new(&Robot::built_in("paper-optimistic").unwrap()).unwrap();
        let link = crate::experiment::SimulatedRobot::new(Mismatch::default(), 1)
            .at_home(&model)
            .unwrap();
        let sent = Arc::new(AtomicU64::new(0));
        let mut client = Client::connect(Live(link, sent.clone()), SessionId(7)).unwrap();
        let (before_us, before) = (client.now_us(), sent.load(Ordering::Relaxed));
        // A second of the board's time; it detects a host that is silent for a tenth of that.
        let enough = before + 1_000_000 / BEAT_US;
        let heard = meanwhile(&mut client, || {
            let begun = Instant::now();
            while sent.load(Ordering::Relaxed) < enough {
                if begun.elapsed() > Duration::from_secs(60) {
                    return false;
                }
                std::thread::yield_now();
            }
            true
        });
        assert!(heard.unwrap(), "the work waited for heartbeats in vain");
        assert!(client.now_us() > before_us + 900_000);
        let last = client.beat().unwrap();
        assert!(last.sent_us + 2 * BEAT_US > client.now_us(), "{last:?}");
        assert_eq!(last.state, BoardState::Disarmed);
    }
}
