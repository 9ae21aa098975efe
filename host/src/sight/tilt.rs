//! Roll and pitch by an inclinometer or inertial unit on the platform: on a serial port of its own, or of the simulated
//! robot.

use super::{SightError, TagSource, TagView};
use crate::link::SimulatedLink;
use mcdpr_core::random::Random;
use mcdpr_kinematics::rpy_from_rotation;
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// A source of roll and pitch.
pub trait TiltSource {
    /// Mean of roll and pitch since the last call, R = Rz Ry Rx of the sensor, rad; `None` if nothing has arrived.
    ///
    /// # Errors
    /// [`SightError::NoTilt`] if the sensor is gone or sends something else.
    fn read_rad(&mut self) -> Result<Option<[f64; 2]>, SightError>;
}

impl<T: TiltSource> TiltSource for Option<T> {
    fn read_rad(&mut self) -> Result<Option<[f64; 2]>, SightError> {
        self.as_mut().map_or(Ok(None), TiltSource::read_rad)
    }
}

/// Tags with an inclinometer beside the camera.
pub struct WithTilt<S, T> {
    /// The camera.
    pub tags: S,
    /// The inclinometer.
    pub tilt: T,
}

impl<S: TagSource, T: TiltSource> TagSource for WithTilt<S, T> {
    fn look(&mut self) -> Result<Vec<TagView>, SightError> {
        self.tags.look()
    }

    fn poll(&mut self) -> Option<Result<Vec<TagView>, SightError>> {
        self.tags.poll()
    }

    fn tilt_rad(&mut self) -> Result<Option<[f64; 2]>, SightError> {
        self.tilt.read_rad()
    }
}

/// Mounting of the simulated sensor about each axis, rad, one standard deviation: 1.6 degrees were found on IRMA4U
/// (University of Bologna).
const MOUNT_RAD: f64 = 0.028;
/// Error of its scale, one standard deviation: an assumption.
const SCALE: f64 = 2e-3;

/// The simulated robot's inclinometer: the plant's true attitude, turned by an unknown mounting, with errors of scale
/// and noise.
pub struct SimulatedTilt {
    link: SimulatedLink,
    mount: Rotation3<f64>,
    scale: [f64; 2],
    noise_rad: f64,
    random: Random,
}

impl SimulatedTilt {
    /// The sensor of the robot behind `link`; the seed determines its mounting.
    #[must_use]
    pub fn new(link: SimulatedLink, noise_rad: f64, seed: u64) -> Self {
        let mut random = Random::new(seed ^ 0x696e_636c);
        let mount = Vector3::from_fn(|_, _| MOUNT_RAD * random.normal());
        Self {
            link,
            mount: Rotation3::new(mount),
            scale: [(); 2].map(|()| 1.0 + SCALE * random.normal()),
            noise_rad,
            random,
        }
    }

    /// How it is truly turned on the platform: rotation vector of platform_from_sensor, rad.
    #[must_use]
    pub fn mount_rad(&self) -> Vector3<f64> {
        self.mount.scaled_axis()
    }
}

impl TiltSource for SimulatedTilt {
    fn read_rad(&mut self) -> Result<Option<[f64; 2]>, SightError> {
        let truth = self.link.with(|simulation| simulation.plant().truth());
        let truth = truth.map_err(|error| SightError::Simulation {
            what: error.to_string(),
        })?;
        let rows = truth.pose.matrix();
        let platform = Rotation3::from_matrix_unchecked(Matrix3::from_fn(|i, j| rows[i][j]));
        let [roll, pitch, _] = rpy_from_rotation(&(platform * self.mount));
        let [by_roll, by_pitch] = self.scale;
        let mut read = |angle: f64| angle + self.noise_rad * self.random.normal();
        Ok(Some([read(roll * by_roll), read(pitch * by_pitch)]))
    }
}

/// Longest wait for a byte before the thread looks whether it is still wanted.
const WAIT: Duration = Duration::from_millis(100);
/// After this many lines that are no readings the sensor counts as something else.
const FOREIGN_MAX: usize = 50;
/// No line is longer than this, bytes.
const LINE_MAX: u64 = 256;

/// What has arrived since the last call.
#[derive(Default)]
struct Arrived {
    sum_rad: [f64; 2],
    count: u32,
    ended: Option<String>,
}

/// An inclinometer that sends lines of roll and pitch in degrees, `ROLL PITCH` or `ROLL,PITCH,YAW`, on a serial port.
/// Lines that begin with `#` are comments.
pub(crate) struct SerialTilt {
    arrived: Arc<Mutex<Arrived>>,
}

impl SerialTilt {
    /// Opens a port at `baud` bit/s; a thread reads it from now on.
    ///
    /// # Errors
    /// [`SightError::NoTilt`] if the port cannot be opened.
    pub(crate) fn open(port: &str, baud: u32) -> Result<Self, SightError> {
        let opened = serialport::new(port, baud).timeout(WAIT).open();
        let failed = |reason: String| SightError::NoTilt {
            what: format!("{port}: {reason}"),
        };
        let opened = opened.map_err(|error| failed(error.to_string()))?;
        Self::of(opened).map_err(|error| failed(error.to_string()))
    }

    /// Reads lines from anything; a time-out is no end.
    fn of(lines: impl Read + Send + 'static) -> std::io::Result<Self> {
        let arrived = Arc::new(Mutex::new(Arrived::default()));
        let shared = Arc::downgrade(&arrived);
        let work = move || {
            let mut lines = BufReader::new(lines);
            let (mut line, mut foreign) = (Vec::new(), 0);
            // Ends once nobody asks any more.
            while let Some(shared) = shared.upgrade() {
                let ended = match next(&mut lines, &mut line) {
                    Ok(false) => continue,
                    Ok(true) => {
                        let text = String::from_utf8_lossy(&line).trim().to_owned();
                        line.clear();
                        let mut arrived = shared.lock().unwrap_or_else(PoisonError::into_inner);
                        match reading(&text) {
                            Some([roll, pitch]) => {
                                foreign = 0;
                                arrived.sum_rad[0] += roll;
                                arrived.sum_rad[1] += pitch;
                                arrived.count += 1;
                            }
                            None if text.is_empty() || text.starts_with('#') => {}
                            None => foreign += 1,
                        }
                        if foreign < FOREIGN_MAX {
                            continue;
                        }
                        drop(arrived);
                        format!(
                            "{FOREIGN_MAX} lines in a row are no roll and pitch, such as {text:?}"
                        )
                    }
                    Err(error) => error.to_string(),
                };
                let mut arrived = shared.lock().unwrap_or_else(PoisonError::into_inner);
                arrived.ended = Some(ended);
                return;
            }
        };
        let thread = std::thread::Builder::new().name("inclinometer".to_owned());
        thread.spawn(work)?;
        Ok(Self { arrived })
    }
}

/// Reads on; whether `line` is whole now.
fn next(lines: &mut impl BufRead, line: &mut Vec<u8>) -> std::io::Result<bool> {
    let before = line.len();
    match lines.take(LINE_MAX).read_until(b'\n', line) {
        Ok(0) if line.len() == before => Err(std::io::Error::new(
            ErrorKind::UnexpectedEof,
            "the port was closed",
        )),
        Ok(_) => Ok(line.ends_with(b"\n") || line.len() as u64 >= LINE_MAX),
        Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => {
            Ok(false)
        }
        Err(error) => Err(error),
    }
}

/// Roll and pitch of a line, rad; the yaw of an inertial unit may follow.
fn reading(text: &str) -> Option<[f64; 2]> {
    let words: Vec<&str> = text
        .split([' ', '\t', ',', ';'])
        .filter(|word| !word.is_empty())
        .collect();
    let (2 | 3) = words.len() else { return None };
    let numbers: Option<Vec<f64>> = words.iter().map(|word| word.parse().ok()).collect();
    match numbers?.as_slice() {
        [roll, pitch, ..] if roll.abs() <= 180.0 && pitch.abs() <= 90.0 => {
            Some([roll.to_radians(), pitch.to_radians()])
        }
        _ => None,
    }
}

impl TiltSource for SerialTilt {
    fn read_rad(&mut self) -> Result<Option<[f64; 2]>, SightError> {
        let mut arrived = self.arrived.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(what) = arrived.ended.clone() {
            return Err(SightError::NoTilt { what });
        }
        let Arrived { sum_rad, count, .. } = std::mem::take(&mut *arrived);
        Ok((count > 0).then(|| sum_rad.map(|sum| sum / f64::from(count))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_roll_and_pitch_in_degrees() {
        let right = Some([0.5_f64.to_radians(), (-1.25_f64).to_radians()]);
        for line in [
            "0.5 -1.25",
            "0.5,-1.25,170",
            " 0.5;\t-1.25 ",
            "+5e-1 -1.25 0",
        ] {
            assert_eq!(reading(line), right, "{line}");
        }
        for line in [
            "", "0.5", "nan 1", "1 inf", "1 2 3 4", "roll 1", "190 0", "0 91",
        ] {
            assert_eq!(reading(line), None, "{line}");
        }
    }

    /// What a source says once it has anything to say.
    fn waited(source: &mut SerialTilt) -> Result<[f64; 2], SightError> {
        loop {
            match source.read_rad() {
                Ok(None) => std::thread::yield_now(),
                Ok(Some(read)) => return Ok(read),
                Err(error) => return Err(error),
            }
        }
    }

    #[test]
    fn a_port_that_closes_or_sends_something_else_is_named() {
        let mut closed = SerialTilt::of(&b"# an inclinometer\n"[..]).unwrap();
        let error = waited(&mut closed).unwrap_err().to_string();
        assert!(error.contains("the port was closed"), "{error}");
        let lines: &'static [u8] = Box::leak("$GPGGA,1\n".repeat(60).into_boxed_str()).as_bytes();
        let mut foreign = SerialTilt::of(lines).unwrap();
        let error = waited(&mut foreign).unwrap_err().to_string();
        assert!(
            error.contains("no roll and pitch") && error.contains("GPGGA"),
            "{error}"
        );
        assert!(SerialTilt::open("/dev/no-such-port", 115_200).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn readings_come_over_a_real_port() {
        use serialport::{SerialPort, TTYPort};
        use std::io::Write as _;
        let (mut sensor, device) = TTYPort::pair().unwrap();
        let name = device.name().unwrap();
        // Keeps the device open; the reader has it for itself.
        let _open = std::fs::File::open(&name).unwrap();
        drop(device);
        let mut source = SerialTilt::open(&name, 115_200).unwrap();
        // In two parts: a time-out in the middle of a line loses nothing.
        sensor.write_all(b"2.0 -1").unwrap();
        sensor.write_all(b".0\r\n").unwrap();
        let [roll, pitch] = waited(&mut source).unwrap();
        assert!(
            (roll.to_degrees() - 2.0).abs() < 1e-12 && (pitch.to_degrees() + 1.0).abs() < 1e-12
        );
    }
}
