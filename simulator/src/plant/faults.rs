//! Injected faults. They act on the plant, never inside a controller.

use super::params::MAX_CABLES;

/// Fault of a drum encoder as the board sees it. A fault begins and ends with the first reading
/// after it is set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EncoderFault {
    /// None.
    #[default]
    None,
    /// The count stays where it was when the fault began.
    Stuck,
    /// Open inputs behind pull-ups: the count stays where it was and flickers by one.
    Disconnected,
    /// Open inputs without pull-ups: they float, and count interference in either direction.
    Floating,
    /// Swapped channels: the count runs backwards from where the fault began.
    Reversed,
    /// The next reading alone is off by this many counts; then the fault is gone.
    Glitch(i16),
}

/// Fault of a tension sensor as the board sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TensionFault {
    /// None.
    #[default]
    None,
    /// Open input: pulled up as docs/wiring.md has it.
    Open,
    /// Open input with another pull-up, ohm.
    OpenWith(u32),
    /// Short: lower rail.
    Short,
    /// The same reading for ever, bit by bit.
    Frozen,
}

/// Fault of a brake.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BrakeFault {
    /// It never opens.
    pub stays_closed: bool,
    /// Share of the nominal holding force that is left.
    pub holding_factor: f64,
    /// It closes later than specified by this (s).
    pub extra_close_delay_s: f64,
    /// Its coil's current freewheels through a plain diode instead of falling against a voltage.
    pub freewheels: bool,
    /// It drags: additional friction on the drum (N).
    pub drag_n: f64,
}

impl Default for BrakeFault {
    fn default() -> Self {
        Self {
            stays_closed: false,
            holding_factor: 1.0,
            extra_close_delay_s: 0.0,
            freewheels: false,
            drag_n: 0.0,
        }
    }
}

/// Fault of a drive or its connection to the bus.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DriveFault {
    /// It executes commands but sends no feedback.
    pub silent: bool,
    /// It answers but executes no command; it continues its last one.
    pub ignores_commands: bool,
    /// Reset and mode choice take this much longer (s); infinity: for ever.
    pub late_s: f64,
}

/// The faults of one cable with its winch, drive and sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CableFaults {
    /// Drum encoder.
    pub encoder: EncoderFault,
    /// Tension sensor.
    pub tension: TensionFault,
    /// The sensor's noise is this many times the nominal.
    pub tension_noise_factor: f64,
    /// Added to the sensed tension (N).
    pub tension_offset_n: f64,
    /// Growth of the offset (N/s).
    pub tension_drift_n_per_s: f64,
    /// Drive.
    pub drive: DriveFault,
    /// Brake.
    pub brake: BrakeFault,
}

impl Default for CableFaults {
    fn default() -> Self {
        Self {
            encoder: EncoderFault::None,
            tension: TensionFault::None,
            tension_noise_factor: 1.0,
            tension_offset_n: 0.0,
            tension_drift_n_per_s: 0.0,
            drive: DriveFault::default(),
            brake: BrakeFault::default(),
        }
    }
}

/// All active faults. Change them at any time between two calls of `advance`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Faults {
    /// Per cable, index from 0; entries beyond the robot's cables do nothing.
    pub cables: [CableFaults; MAX_CABLES],
    /// The bus transmits nothing in either direction. Drives continue their last command.
    pub bus_off: bool,
}
