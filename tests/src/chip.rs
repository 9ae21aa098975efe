//! The firmware's own file, as the tests on the emulated chip take it.

use mcdpr::machine::Firmware;
use std::path::PathBuf;

/// A line of some three seconds on the paper's robot, as a task file.
pub const LINE: &str = "start_mm = [255, -105, -180]\n[[leg]]\nto_mm = [335, -65, -180]\n";

/// Where the file is: `MCDPR_FIRMWARE`, or what `cargo fw` builds.
#[must_use]
pub fn path() -> PathBuf {
    let built = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../target/thumbv7m-none-eabi/firmware/mcdpr-firmware"
    );
    std::env::var_os("MCDPR_FIRMWARE").map_or_else(|| built.into(), PathBuf::from)
}

/// The file.
///
/// # Panics
/// Where it is not built: a test that cannot run the chip must not pass.
#[must_use]
pub fn firmware() -> Firmware {
    let found = Firmware::find(Some(&path()));
    assert!(
        found.is_ok(),
        "build the firmware with `cargo fw`: {:?}",
        found.err()
    );
    #[expect(clippy::unwrap_used, reason = "just seen")]
    found.unwrap()
}
