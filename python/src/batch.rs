//! Rows of a batch on all processors.
//!
//! Threads are started for the call and end with it. A pool that outlives it would be missing in a process
//! that Python's `multiprocessing` forks, which would then wait for it for ever.

use crate::failure::Failure;
use std::num::NonZero;
use std::ops::Range;
use std::panic::resume_unwind;
use std::thread;

/// Rows for which another thread is worth its start (some tens of µs): of a closed form, about 0.1 µs a row.
pub(crate) const CLOSED_FORM: usize = 4096;
/// The same of an iterative solution, 10 µs a row and more.
pub(crate) const ITERATIVE: usize = 32;

/// Runs `work` on parts of `count` rows. Each part has its range of rows, and those rows of each table, which
/// has `widths` numbers in a row. A part has `least` rows or more.
///
/// # Errors
/// The failure of the lowest part that fails.
pub(crate) fn in_parts<const K: usize>(
    tables: &mut [Vec<f64>; K],
    widths: [usize; K],
    count: usize,
    least: usize,
    work: impl Fn(Range<usize>, [&mut [f64]; K]) -> Result<(), Failure> + Sync,
) -> Result<(), Failure> {
    let processors = thread::available_parallelism().map_or(1, NonZero::get);
    let parts = (count / least).clamp(1, processors);
    let mut left = tables.each_mut().map(Vec::as_mut_slice);
    let work = &work;
    thread::scope(|scope| {
        let mut running = Vec::new();
        for part in 0..parts {
            let rows = count * part / parts..count * (part + 1) / parts;
            let mut which = widths.iter();
            let own = left.each_mut().map(|slice| {
                let width = which.next().copied().unwrap_or(0);
                let (own, rest) = std::mem::take(slice).split_at_mut(width * rows.len());
                *slice = rest;
                own
            });
            if part + 1 == parts {
                // The last part is this thread's.
                let last = work(rows, own);
                let done = running
                    .into_iter()
                    .map(|thread: thread::ScopedJoinHandle<'_, _>| {
                        thread.join().unwrap_or_else(|panic| resume_unwind(panic))
                    });
                return done.chain([last]).collect();
            }
            running.push(scope.spawn(move || work(rows, own)));
        }
        Ok(())
    })
}
