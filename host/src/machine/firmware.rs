//! The firmware file, and the emulated chip that executes it in front of the simulated robot.

use crate::hil::Wires;
use miette::Diagnostic;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use thiserror::Error;

/// The output of `cargo fw`.
const BUILT: &str = "target/thumbv7m-none-eabi/firmware/mcdpr-firmware";
/// Environment variable that names the file if the command line does not.
const VARIABLE: &str = "MCDPR_FIRMWARE";

/// Most bytes of a firmware file, its debug information included.
const MOST_BYTES: u64 = 256 << 20;

/// Why the firmware cannot be executed.
#[derive(Debug, Error, Diagnostic)]
pub enum FirmwareError {
    /// The file cannot be read.
    #[error("the firmware {path} cannot be read: {reason}")]
    #[diagnostic(
        code(mcdpr::firmware::missing),
        help(
            "build it with `cargo fw`, or say where it is with --firmware FILE (or in the environment, MCDPR_FIRMWARE=FILE)"
        )
    )]
    Missing {
        /// The file that was looked for.
        path: String,
        /// The system's message.
        reason: String,
    },
    /// The file is not firmware for the board's chip.
    #[error("{path} is not the board's firmware: {reason}")]
    #[diagnostic(
        code(mcdpr::firmware::unsuitable),
        help("the board is an STM32F103C8; `cargo fw` builds its file")
    )]
    Unsuitable {
        /// The file.
        path: String,
        /// What is wrong with it.
        reason: String,
    },
    /// This program cannot execute it.
    #[error("this mcdpr was built without the emulated chip")]
    #[diagnostic(
        code(mcdpr::firmware::no_emulator),
        help("build it with the feature `emulator`, which is on by default")
    )]
    NoEmulator,
}

/// A firmware file that the emulated chip accepts.
#[derive(Clone)]
pub struct Firmware {
    bytes: Arc<[u8]>,
}

impl std::fmt::Debug for Firmware {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "Firmware of {} bytes", self.bytes.len())
    }
}

impl Firmware {
    /// The file's bytes.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// What the file puts into flash, from flash's start, without the erased rest.
    #[must_use]
    pub fn flash(&self) -> Vec<u8> {
        #[cfg(feature = "emulator")]
        let flash = mcdpr_emulator::flash_image(&self.bytes).unwrap_or_default();
        #[cfg(not(feature = "emulator"))]
        let flash = Vec::new();
        flash
    }

    /// The file at `path`; else the one named by MCDPR_FIRMWARE; else the output of `cargo fw`.
    ///
    /// # Errors
    /// There is no such file, or it is not firmware for this chip.
    pub fn find(path: Option<&Path>) -> Result<Self, FirmwareError> {
        let path = path.map_or_else(
            || std::env::var_os(VARIABLE).map_or_else(|| PathBuf::from(BUILT), PathBuf::from),
            Path::to_path_buf,
        );
        let shown = path.display().to_string();
        let bytes = crate::files::read_bytes(&path, MOST_BYTES).map_err(|error| {
            FirmwareError::Missing {
                path: shown.clone(),
                reason: error.to_string(),
            }
        })?;
        Self::new(&shown, bytes)
    }

    /// From the bytes of a file with this name.
    ///
    /// # Errors
    /// If they are not firmware for this chip.
    #[cfg(feature = "emulator")]
    pub fn new(name: &str, bytes: Vec<u8>) -> Result<Self, FirmwareError> {
        match mcdpr_emulator::Chip::load(&bytes) {
            Ok(_) => Ok(Self {
                bytes: bytes.into(),
            }),
            Err(error) => Err(FirmwareError::Unsuitable {
                path: name.to_owned(),
                reason: error.to_string(),
            }),
        }
    }

    /// From the bytes of a file: not in this build.
    ///
    /// # Errors
    /// Always.
    #[cfg(not(feature = "emulator"))]
    pub fn new(_name: &str, _bytes: Vec<u8>) -> Result<Self, FirmwareError> {
        Err(FirmwareError::NoEmulator)
    }

    /// A chip with this file that just got power, as a board for the simulated robot.
    #[cfg(feature = "emulator")]
    #[must_use]
    pub fn board(&self) -> Option<mcdpr_emulator::ChipBoard> {
        // The file was accepted before.
        mcdpr_emulator::ChipBoard::load(&self.bytes).ok()
    }

    /// As [`Self::board`], for these cables of a plant; `number` from 0 tells several boards of one
    /// robot apart.
    #[must_use]
    pub(crate) fn board_for(
        &self,
        cables: &[usize],
        number: u8,
    ) -> Option<Box<dyn mcdpr_simulator::VirtualBoard + Send>> {
        #[cfg(feature = "emulator")]
        let board = self.board()?.wired(cables, number)?;
        #[cfg(not(feature = "emulator"))]
        let board = {
            let _ = (cables, number);
            self.board()?
        };
        #[cfg(feature = "emulator")]
        let board: Box<dyn mcdpr_simulator::VirtualBoard + Send> = Box::new(board);
        Some(board)
    }

    /// A chip with this file: not in this build.
    #[cfg(not(feature = "emulator"))]
    #[must_use]
    pub fn board(&self) -> Option<Box<dyn mcdpr_simulator::VirtualBoard + Send>> {
        None
    }
}

/// What controls a simulated robot.
#[derive(Debug, Clone, Default)]
pub enum Controller {
    /// The control core, in this process.
    #[default]
    InProcess,
    /// The firmware's own file, executed by an emulated chip.
    Chip(Firmware),
    /// A real board, behind wires.
    Hil(Wires),
}

impl Controller {
    /// The chip with this firmware, or the control core in this process.
    #[must_use]
    pub(crate) fn of(firmware: Option<&Firmware>) -> Self {
        firmware.map_or(Self::InProcess, |firmware| Self::Chip(firmware.clone()))
    }

    /// The wires to a board outside.
    #[must_use]
    pub(crate) const fn wires(&self) -> Option<&Wires> {
        match self {
            Self::Hil(wires) => Some(wires),
            _ => None,
        }
    }

    /// Whether it is the control core in this process.
    #[must_use]
    pub(crate) const fn is_in_process(&self) -> bool {
        matches!(self, Self::InProcess)
    }

    /// The firmware that the emulated chip executes.
    #[must_use]
    pub(crate) const fn firmware(&self) -> Option<&Firmware> {
        match self {
            Self::InProcess | Self::Hil(_) => None,
            Self::Chip(firmware) => Some(firmware),
        }
    }

    /// CRC-32 of the firmware's file, which records name.
    #[must_use]
    pub(crate) fn firmware_crc(&self) -> Option<u32> {
        let firmware = self.firmware()?;
        Some(mcdpr_protocol::frame::crc32(firmware.bytes()))
    }
}
