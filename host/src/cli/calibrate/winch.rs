//! `mcdpr calibrate winch N`: the motor ratio of a bare winch.

use crate::cli::service::{Machine, connected};
use crate::cli::{Common, Outcome, print_json};
use crate::service::measure_ratio;

/// Motor counts per drum encoder count of one bare winch (Eq. 50), with spread and backlash
///
/// No cable may be on the drum: it is turned, out and back
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    /// Number of the winch, as its cable in the robot file, from 1
    winch: usize,
    /// Encoder revolutions each way
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(2..=20))]
    turns: u32,
    #[command(flatten)]
    machine: Machine,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        let robot = crate::robot::find(&common.robot)?;
        crate::service::known(&robot, self.winch)?;
        let name = format!("winch-ratio-{}", self.winch);
        let (ratio, folder) =
            connected(common, &robot, &self.machine, &name, |(mut client, _)| {
                Ok(measure_ratio(&mut client, &robot, self.winch, self.turns)?)
            })?;
        if common.json {
            return print_json(&ratio);
        }
        say!(
            "winch {}: {:.3} motor counts per encoder count (sd {:.3} over {} turns); the robot file says {:.3}",
            ratio.winch,
            ratio.rho,
            ratio.rho_sd,
            ratio.turns.len(),
            ratio.rho_described
        );
        say!(
            "motor_counts_per_turn = {:.0}, encoder_sign = {}",
            ratio.motor_counts_per_turn,
            ratio.encoder_sign
        );
        if ratio.backlash_motor_counts > ratio.backlash_resolution {
            say!("backlash: {:.0} motor counts", ratio.backlash_motor_counts);
        } else {
            say!(
                "backlash: less than the {:.0} motor counts that one encoder count is",
                ratio.backlash_resolution
            );
        }
        say!("run folder: {}", folder.path().display());
        Ok(())
    }
}
