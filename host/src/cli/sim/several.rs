//! A simulated robot of several boards behind a pseudo-terminal for each.

use super::super::{Common, Failed, Outcome, print_json};
use crate::link::{ClientError, SimulatedLink, plant_failed};
use crate::run::interrupted;
use serialport::{SerialPort, TTYPort};
use std::io::{ErrorKind, Read, Write};
use std::time::{Duration, Instant};

/// Least time that is simulated at once, µs: several bytes are written together.
const GRAIN_US: u64 = 1000;

/// Serves the boards, at `scale` simulated seconds per second.
pub(super) fn serve(robot: &SimulatedLink, common: &Common, scale: f64) -> Outcome {
    let failed = || Failed::from_error("making a pseudo-terminal");
    let boards = robot.with(|simulation| simulation.boards());
    let (mut sides, mut names, mut keep_alive) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..boards {
        let (mut host_side, device) = TTYPort::pair().map_err(failed())?;
        // All of them are looked at in every turn.
        host_side
            .set_timeout(Duration::from_millis(1))
            .map_err(failed())?;
        let name = device.name().unwrap_or_default();
        // Another program must have the device for itself; a plain handle only keeps it open.
        keep_alive.push(std::fs::File::open(&name).map_err(Failed::from_error("opening it"))?);
        sides.push(host_side);
        names.push(name);
    }
    let name = names.join(",");
    if common.json {
        print_json(&serde_json::json!({ "port": name }))?;
    } else {
        say!("{name}");
        eprintln!("the simulated robot hangs at home; give all ports: --on {name}");
    }
    // A reader that waits for the name must not wait for a full buffer.
    let _ = std::io::stdout().flush();
    let began = Instant::now();
    let mut buffer = [0; 512];
    while !interrupted() {
        let mut heard = Vec::new();
        for side in &mut sides {
            let used = match side.read(&mut buffer) {
                Ok(used) => used,
                Err(error)
                    if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) =>
                {
                    0
                }
                Err(error) => {
                    return Err(Failed::from_error("reading the pseudo-terminal")(error).into());
                }
            };
            heard.push(buffer.get(..used).unwrap_or_default().to_vec());
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "positive"
        )]
        let now_us = (began.elapsed().as_secs_f64() * 1e6 * scale) as u64;
        while robot.with(|simulation| simulation.now_us()) < now_us {
            let mut said = vec![Vec::new(); boards];
            let advanced = robot.with(|simulation| {
                let until_us = now_us.min(simulation.now_us() + GRAIN_US);
                while simulation.now_us() < until_us {
                    let mut new = vec![Vec::new(); boards];
                    simulation.advance_all(until_us, &mut new)?;
                    for (said, new) in said.iter_mut().zip(new) {
                        said.extend(new);
                    }
                }
                Ok(())
            });
            advanced.map_err(|error| ClientError::from(plant_failed(error)))?;
            for (side, said) in sides.iter_mut().zip(&said) {
                // There may be no reader: a full pseudo-terminal loses bytes like a real line.
                let _ = side.write(said);
            }
        }
        // Only now: a byte must not reach a board before it was sent, however late this loop is.
        for (board, bytes) in heard.iter().enumerate() {
            robot.with(|simulation| simulation.send_to(board, bytes));
        }
    }
    drop(keep_alive);
    Ok(())
}
