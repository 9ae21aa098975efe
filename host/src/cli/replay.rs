//! `mcdpr replay RUN`: runs host and core again on the recorded bytes.

use super::{Common, Outcome, print_json};
use crate::record;
use crate::replay::replay;
use std::path::PathBuf;
use std::time::Instant;

/// Run host and core again on a recorded run's bytes and check that they do the same
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// The run's folder, or its run.mcap
    run: PathBuf,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let run = record::load(&self.run)?;
        if let Some(damage) = &run.damage {
            eprintln!("{}", damage.words());
        }
        let began = Instant::now();
        let proof = replay(&run, &common.controller)?;
        let took_s = began.elapsed().as_secs_f64();
        let factor = run.duration_s() / took_s.max(1e-9);
        if common.json {
            return print_json(&serde_json::json!({
                "equal": true,
                "whole": proof.whole,
                "calls": proof.calls,
                "host_bytes": proof.host_bytes,
                "core_bytes": proof.core_bytes,
                "duration_s": run.duration_s(),
                "took_s": took_s,
                "realtime_factor": factor,
            }));
        }
        let calls = proof.calls;
        match proof.host_bytes {
            Some(bytes) => {
                say!("host: sent the same {bytes} bytes again in {calls} calls of the line")
            }
            None => say!(
                "host: not run again; people or pictures controlled it ({calls} calls of the \
                 line)"
            ),
        }
        match proof.core_bytes {
            Some(bytes) => say!("core and plant: answered the same {bytes} bytes again"),
            None => say!(
                "core: not run again; the record is of a board, whose pins are not on the line, or \
                 of a chip's firmware that was not named (--on chip --firmware FILE)"
            ),
        }
        if !proof.whole {
            say!("the record is cut short; it is the same as far as it goes");
        }
        say!(
            "{:.2} s replayed in {took_s:.2} s ({factor:.0} times real time)",
            run.duration_s()
        );
        Ok(())
    }
}
