//! The simulated robot's inclinometer behind a pseudo-terminal of its own.

use crate::cli::Failed;
use crate::link::{Link as _, SimulatedLink};
use crate::robot::Robot;
use crate::sight::{SimulatedTilt, TiltSource as _};
use serialport::{SerialPort as _, TTYPort};
use std::fs::File;
use std::io::Write as _;
use std::time::Duration;

/// Simulated time between two lines, us.
const EVERY_US: u64 = 20_000;

/// The sensor and its line.
pub(in crate::cli) struct TiltPort {
    sensor: SimulatedTilt,
    port: TTYPort,
    name: String,
    next_us: u64,
    _keep_alive: File,
}

impl TiltPort {
    /// Makes the pseudo-terminal; `None` if the robot has no inclinometer.
    ///
    /// # Errors
    /// If there are no more pseudo-terminals.
    pub(in crate::cli) fn open(
        robot: &Robot,
        link: &SimulatedLink,
        seed: u64,
    ) -> Result<Option<Self>, Failed> {
        let Some(imu) = robot.imu else {
            return Ok(None);
        };
        let failed = || Failed::from_error("making a pseudo-terminal for the inclinometer");
        let (mut port, device) = TTYPort::pair().map_err(failed())?;
        // Without a reader the line is full at some time: readings are then lost as on a real one.
        port.set_timeout(Duration::from_micros(1))
            .map_err(failed())?;
        let name = device.name().unwrap_or_default();
        let keep_alive = File::open(&name).map_err(Failed::from_error("opening it"))?;
        Ok(Some(Self {
            sensor: SimulatedTilt::new(link.clone(), imu.noise_rad, seed),
            port,
            name,
            next_us: link.now_us(),
            _keep_alive: keep_alive,
        }))
    }

    /// Name of the device.
    pub(in crate::cli) fn name(&self) -> &str {
        &self.name
    }

    /// Sends the lines that are due.
    ///
    /// # Errors
    /// If the simulation has failed.
    pub(in crate::cli) fn send(&mut self, now_us: u64) -> miette::Result<()> {
        if now_us < self.next_us {
            return Ok(());
        }
        self.next_us = now_us + EVERY_US;
        if let Some(tilt) = self.sensor.read_rad()? {
            let [roll, pitch] = tilt.map(f64::to_degrees);
            let _ = self
                .port
                .write_all(format!("{roll:.4} {pitch:.4}\n").as_bytes());
        }
        Ok(())
    }
}
