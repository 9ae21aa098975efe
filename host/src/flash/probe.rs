//! The debug probe: lists probes, checks that the chip behind one is the board's, and writes it.

use super::{CHIP, FlashError};
use probe_rs::flashing::{DownloadOptions, FlashProgress, ProgressEvent};
use probe_rs::probe::list::{Accessibility, Lister, ProbeListItem};
use probe_rs::{MemoryInterface, Permissions, Session};

/// Start of flash.
const FLASH: u64 = 0x0800_0000;
/// DBGMCU_IDCODE of the STM32F1 (RM0008, 31.6.1); its low 12 bits name the device.
const IDCODE: u64 = 0xE004_2000;
/// Medium-density devices: 64 or 128 KB of flash (RM0008, 31.6.1).
const MEDIUM_DENSITY: u32 = 0x410;
/// Flash size in KB, half a word (RM0008, 30.1).
const FLASH_SIZE: u64 = 0x1FFF_F7E0;
/// The firmware's memory map needs this much, KB.
const FLASH_KB: u16 = 64;

/// A connected probe.
#[derive(Debug, Clone)]
pub(crate) struct Probe {
    item: ProbeListItem,
}

impl Probe {
    /// Its serial number; empty if it has none.
    #[must_use]
    pub fn serial(&self) -> &str {
        self.item.info.serial_number.as_deref().unwrap_or_default()
    }

    /// Its description.
    #[must_use]
    pub fn name(&self) -> String {
        let info = &self.item.info;
        let denied = match self.item.accessibility {
            Accessibility::Accessible => "",
            Accessibility::PermissionDenied => ", no permission",
        };
        let (vendor, product) = (info.vendor_id, info.product_id);
        let (kind, serial) = (info.probe_type(), self.serial());
        format!(
            "{} {vendor:04x}:{product:04x} {serial} ({kind}{denied})",
            info.identifier
        )
    }
}

/// The probes that are connected now.
#[must_use]
pub(crate) fn probes() -> Vec<Probe> {
    let items = Lister::new().list_all_with_access();
    items.into_iter().map(|item| Probe { item }).collect()
}

/// The one that is meant.
fn choose(serial: Option<&str>) -> Result<Probe, FlashError> {
    let mut all = probes();
    let found = all.iter().map(Probe::name).collect::<Vec<_>>().join(", ");
    if all.is_empty() {
        return Err(FlashError::NoProbe);
    }
    if let Some(asked) = serial {
        let place = all.iter().position(|probe| probe.serial() == asked);
        return match place {
            Some(place) => Ok(all.swap_remove(place)),
            None => Err(FlashError::UnknownProbe {
                asked: asked.to_owned(),
                found,
            }),
        };
    }
    match all.pop() {
        Some(probe) if all.is_empty() => Ok(probe),
        _ => Err(FlashError::Several { found }),
    }
}

/// Writes an image to the chip behind a probe (the one with this serial number, or the only one),
/// reads it back, and starts it. `done` is called with the number of bytes written.
///
/// # Errors
/// What is missing or failed; if the chip is another one, nothing was written.
pub fn write(
    image: &[u8],
    serial: Option<&str>,
    mut done: impl FnMut(u64),
) -> Result<(), FlashError> {
    let probe = choose(serial)?;
    if probe.item.accessibility == Accessibility::PermissionDenied {
        let probe = probe.name();
        return Err(FlashError::Permission { probe });
    }
    let open = probe
        .item
        .info
        .open()
        .map_err(failed("opening the probe"))?;
    let mut session = open
        .attach(CHIP, Permissions::default())
        .map_err(failed("attaching to the chip"))?;
    // Before anything is erased: the content of another chip could not be restored.
    check(&mut session)?;
    let mut loader = session.target().flash_loader();
    loader
        .add_data(FLASH, image)
        .map_err(failed("laying out the image"))?;
    let mut options = DownloadOptions::default();
    options.verify = true;
    options.progress = FlashProgress::new(move |event| {
        if let ProgressEvent::Progress { size, .. } = event {
            done(size);
        }
    });
    loader
        .commit(&mut session, options)
        .map_err(failed("writing the chip and reading it back"))?;
    let mut core = session.core(0).map_err(failed("starting the firmware"))?;
    core.reset().map_err(failed("starting the firmware"))
}

/// Checks that the chip is the board's: device and size of flash.
fn check(session: &mut Session) -> Result<(), FlashError> {
    let mut core = session
        .core(0)
        .map_err(failed("asking the chip what it is"))?;
    let id = core
        .read_word_32(IDCODE)
        .map_err(failed("asking the chip what it is"))?;
    let mut size = [0; 1];
    core.read_16(FLASH_SIZE, &mut size)
        .map_err(failed("asking the chip for its flash"))?;
    let device = id & 0xFFF;
    if device == MEDIUM_DENSITY && size[0] >= FLASH_KB {
        return Ok(());
    }
    let found = format!("device {device:#05x} with {} KB of flash", size[0]);
    Err(FlashError::OtherChip { found })
}

/// An error of the probe with all its causes.
fn failed<E: std::error::Error>(step: &'static str) -> impl FnOnce(E) -> FlashError {
    move |error| {
        let mut reason = error.to_string();
        let mut cause = error.source();
        while let Some(inner) = cause {
            reason = format!("{reason}: {inner}");
            cause = inner.source();
        }
        FlashError::Failed { step, reason }
    }
}
