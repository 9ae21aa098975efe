//! Passes the events on a line to watchers, each on a separate thread.

use mcdpr_twin::Sink;
pub use mcdpr_twin::{
    Level, PlanNote, PlanPoint, RunEvent, TruthPoint, TruthTap, Watched, Watcher,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Action if a watcher does not keep up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Patience {
    /// Wait for it: the line's time is virtual, so nothing is late.
    Wait,
    /// Drop events and count them: a robot is moving.
    Drop,
}

/// Greatest number of events waiting for a watcher: ten seconds of a busy line.
const QUEUE: usize = 20_000;
/// After this time without events a watcher gets its idle call.
const IDLE: Duration = Duration::from_millis(250);

/// Events gather for this long before a watcher sees them: a busy line has thousands of short reads a second,
/// and to wake a thread for each took more time than the watchers' work (4 % of a core for a journal). A
/// journal flushes every 50 ms and a page draws every 16 ms, so 10 ms delay neither.
const GATHER: Duration = Duration::from_millis(10);

struct Watching {
    sender: SyncSender<Arc<RunEvent>>,
    patience: Patience,
    lost: Arc<AtomicU64>,
    thread: JoinHandle<()>,
}

/// The watchers of a run.
#[derive(Default)]
pub struct EventBus {
    watchers: Vec<Watching>,
}

impl EventBus {
    /// Adds a watcher, and returns the count of its missed events.
    ///
    /// # Errors
    /// If the system has no thread for it.
    pub fn add(
        &mut self,
        watcher: impl Watcher,
        patience: Patience,
    ) -> std::io::Result<Arc<AtomicU64>> {
        let (sender, receiver) = sync_channel(QUEUE);
        let lost = Arc::new(AtomicU64::new(0));
        let thread = std::thread::Builder::new()
            .name("watcher".to_owned())
            .spawn(move || watch(watcher, &receiver))?;
        self.watchers.push(Watching {
            sender,
            patience,
            lost: Arc::clone(&lost),
            thread,
        });
        Ok(lost)
    }

    /// Ends the run: every watcher processes its waiting events and ends.
    pub fn finish(self) {
        for watching in self.watchers {
            drop(watching.sender);
            // A watcher that panicked has printed its message; the run is not affected.
            let _ = watching.thread.join();
        }
    }
}

impl Sink for EventBus {
    fn is_empty(&self) -> bool {
        self.watchers.is_empty()
    }

    fn publish(&self, event: RunEvent) {
        if self.watchers.is_empty() {
            return;
        }
        let event = Arc::new(event);
        for watching in &self.watchers {
            let copy = Arc::clone(&event);
            match watching.patience {
                // A watcher that ended by itself has reported why.
                Patience::Wait => drop(watching.sender.send(copy)),
                Patience::Drop => {
                    if let Err(TrySendError::Full(_)) = watching.sender.try_send(copy) {
                        watching.lost.fetch_add(1, Ordering::Relaxed);
                    }
                }
            }
        }
    }
}

fn watch(mut watcher: impl Watcher, receiver: &Receiver<Arc<RunEvent>>) {
    loop {
        match receiver.recv_timeout(IDLE) {
            Ok(event) => {
                watcher.see(&event);
                while let Ok(event) = receiver.try_recv() {
                    watcher.see(&event);
                }
                std::thread::sleep(GATHER);
            }
            Err(RecvTimeoutError::Timeout) => watcher.idle(),
            Err(RecvTimeoutError::Disconnected) => {
                watcher.end();
                return;
            }
        }
    }
}
