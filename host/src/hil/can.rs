//! The CAN bus of a board in the loop: an interface of the operating system (SocketCAN), or an adapter
//! on a serial port (slcan).

use super::port::Port;
use super::{HilError, signals, slcan};
use mcdpr_firmware::drives::CanFrame;

/// Bit rate of an adapter's serial port; one on USB has any.
const ADAPTER_BAUD: u32 = 921_600;
/// What a wire is called in an error.
const WHAT: &str = "CAN";

/// A CAN bus with this program as its drives.
pub(super) trait CanWire: Send {
    /// Takes part in the bus, or does not: then it neither sends nor acknowledges.
    fn connect(&mut self, connected: bool) -> Result<(), HilError>;
    /// Queues a frame.
    fn send(&mut self, frame: &CanFrame) -> Result<(), HilError>;
    /// Appends the frames that have arrived. Waits for one, for 2 ms at most, if `wait`.
    fn receive(&mut self, into: &mut Vec<CanFrame>, wait: bool) -> Result<(), HilError>;
}

/// Opens a bus by its name, at this bit rate.
///
/// # Errors
/// There is no such interface or port, or it does not know the bit rate.
pub(super) fn open(name: &str, bits_per_s: u32) -> Result<Box<dyn CanWire>, HilError> {
    if name.contains(['/', '\\']) || name.to_ascii_uppercase().starts_with("COM") {
        let port = Port::open(WHAT, name, ADAPTER_BAUD)?;
        return Ok(Box::new(Adapter::new(port, bits_per_s)?));
    }
    socket(name)
}

#[cfg(target_os = "linux")]
fn socket(name: &str) -> Result<Box<dyn CanWire>, HilError> {
    Ok(Box::new(interface::Interface::open(name)?))
}

#[cfg(not(target_os = "linux"))]
fn socket(name: &str) -> Result<Box<dyn CanWire>, HilError> {
    let help = "give the serial port of an slcan adapter";
    Err(HilError::wire(
        WHAT,
        name,
        "network interfaces for CAN are of Linux",
        help,
    ))
}

/// An adapter that speaks slcan.
struct Adapter {
    port: Port,
    arrived: Vec<u8>,
    set_rate: &'static str,
    connected: bool,
}

impl Adapter {
    fn new(port: Port, bits_per_s: u32) -> Result<Self, HilError> {
        let set_rate = slcan::speed(bits_per_s)
            .ok_or_else(|| port.failed(format!("slcan has no bit rate of {bits_per_s} bit/s")))?;
        let mut adapter = Self {
            port,
            arrived: Vec::new(),
            set_rate,
            connected: false,
        };
        // A channel that another program left open does not take a bit rate.
        adapter.port.write(slcan::CLOSE.as_bytes())?;
        Ok(adapter)
    }
}

impl CanWire for Adapter {
    fn connect(&mut self, connected: bool) -> Result<(), HilError> {
        if connected == self.connected {
            return Ok(());
        }
        self.connected = connected;
        if connected {
            self.port.write(self.set_rate.as_bytes())?;
            self.port.write(slcan::OPEN.as_bytes())
        } else {
            self.port.write(slcan::CLOSE.as_bytes())
        }
    }

    fn send(&mut self, frame: &CanFrame) -> Result<(), HilError> {
        self.port.write(slcan::to_text(frame).as_bytes())
    }

    fn receive(&mut self, into: &mut Vec<CanFrame>, wait: bool) -> Result<(), HilError> {
        self.port.read(&mut self.arrived, wait)?;
        let lines = signals::take_lines(&mut self.arrived);
        into.extend(lines.iter().filter_map(|line| slcan::parse(line)));
        Ok(())
    }
}

#[cfg(target_os = "linux")]
mod interface {
    use super::{CanFrame, CanWire, HilError, WHAT};
    use nix::errno::Errno;
    use socketcan::{CanDataFrame, CanSocket, EmbeddedFrame, Id, Socket, StandardId};
    use std::io::ErrorKind;
    use std::time::Duration;

    const HELP: &str = "bring it up with the drives' bit rate: `sudo ip link set can0 up type can bitrate 1000000`; \
                        `ip link` lists the interfaces; docs/hil.md has more";

    /// A network interface for CAN.
    pub(super) struct Interface {
        socket: CanSocket,
        name: String,
        connected: bool,
    }

    impl Interface {
        pub(super) fn open(name: &str) -> Result<Self, HilError> {
            let fails = |error: std::io::Error| HilError::wire(WHAT, name, error, HELP);
            let socket = CanSocket::open(name).map_err(fails)?;
            socket.set_nonblocking(true).map_err(fails)?;
            Ok(Self {
                socket,
                name: name.to_owned(),
                connected: false,
            })
        }

        fn failed(&self, reason: impl ToString) -> HilError {
            HilError::wire(WHAT, &self.name, reason, HELP)
        }
    }

    impl CanWire for Interface {
        fn connect(&mut self, connected: bool) -> Result<(), HilError> {
            // The interface itself is the administrator's: it acknowledges on.
            self.connected = connected;
            Ok(())
        }

        fn send(&mut self, frame: &CanFrame) -> Result<(), HilError> {
            let bytes = frame.data.get(..frame.len.into()).unwrap_or(&frame.data);
            let id = StandardId::new(frame.id & 0x7FF);
            let data = id.and_then(|id| CanDataFrame::new(id, bytes));
            let Some(data) = data.filter(|_| self.connected) else {
                return Ok(());
            };
            match self.socket.write_frame(&data) {
                // A full queue: frames are lost, as on a bus that is off.
                Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(()),
                Err(error) if error.raw_os_error() == Some(Errno::ENOBUFS as i32) => Ok(()),
                Err(error) => Err(self.failed(error)),
                Ok(()) => Ok(()),
            }
        }

        fn receive(&mut self, into: &mut Vec<CanFrame>, wait: bool) -> Result<(), HilError> {
            let before = into.len();
            loop {
                let frame = if wait && into.len() == before {
                    self.socket.read_frame_timeout(Duration::from_millis(2))
                } else {
                    self.socket.read_frame()
                };
                let frame = match frame {
                    Ok(frame) => frame,
                    Err(error)
                        if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) =>
                    {
                        return Ok(());
                    }
                    Err(error) => return Err(self.failed(error)),
                };
                let Id::Standard(id) = frame.id() else {
                    continue;
                };
                if !frame.is_data_frame() || !self.connected {
                    continue;
                }
                let mut data = [0; 8];
                for (to, from) in data.iter_mut().zip(frame.data()) {
                    *to = *from;
                }
                #[expect(clippy::cast_possible_truncation, reason = "8 at most")]
                let len = frame.data().len() as u8;
                into.push(CanFrame {
                    id: id.as_raw(),
                    len,
                    data,
                });
            }
        }
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    /// Through the kernel, where it has virtual CAN interfaces and `vcan0` is up; elsewhere the error says
    /// what to do.
    #[test]
    fn frames_pass_between_two_programs_on_an_interface_or_the_error_helps() {
        let (mut one, mut other) = match (open("vcan0", 1_000_000), open("vcan0", 1_000_000)) {
            (Ok(one), Ok(other)) => (one, other),
            (Err(error), _) | (_, Err(error)) => {
                println!("no vcan0 here: {error}");
                assert!(error.to_string().starts_with("CAN vcan0: "), "{error}");
                let help = miette::Diagnostic::help(&error).map(|help| help.to_string());
                assert!(help.is_some_and(|help| help.contains("ip link")));
                return;
            }
        };
        let frame = CanFrame {
            id: 0x123,
            len: 3,
            data: [1, 2, 3, 0, 0, 0, 0, 0],
        };
        for wire in [&mut one, &mut other] {
            wire.connect(true).unwrap();
        }
        one.send(&frame).unwrap();
        let mut found = Vec::new();
        for _ in 0..1000 {
            other.receive(&mut found, true).unwrap();
            if !found.is_empty() {
                break;
            }
        }
        assert_eq!(found, [frame]);
    }
}
