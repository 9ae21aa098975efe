//! The firmware's contracts: it links for the chip, fits its memories, and uses no floating point.

use crate::{cargo, run};
use object::read::elf::ElfFile32;
use object::{Object, ObjectSection, ObjectSymbol, SectionFlags};
use std::path::PathBuf;
use std::process::Command;

const TARGET: &str = "thumbv7m-none-eabi";
/// Most flash, bytes (the chip has 64 KB).
const FLASH_BUDGET: u64 = 60 * 1024;
/// Most static RAM, bytes (the chip has 20 KB; stack and static RAM together have 13 KB).
const RAM_BUDGET: u64 = 10 * 1024;

/// Builds the firmware as it is flashed and checks it.
pub(crate) fn build_and_check() -> Result<(), String> {
    ensure_target(TARGET)?;
    cargo(&["fw", "--locked"])?;
    let path = elf_path();
    let image = std::fs::read(&path).map_err(|error| format!("{}: {error}", path.display()))?;
    check(&image)
}

/// Checks that `kinematics` does without the standard library, as its documentation claims: for a
/// target that has none.
pub(crate) fn kinematics_without_std() -> Result<(), String> {
    ensure_target(TARGET)?;
    cargo(&[
        "check",
        "--locked",
        "-p",
        "mcdpr-kinematics",
        "--no-default-features",
        "--target",
        TARGET,
    ])
}

/// Lints the firmware for its own target, where the board's code exists.
pub(crate) fn lint() -> Result<(), String> {
    ensure_target(TARGET)?;
    cargo(&[
        "clippy",
        "--locked",
        "-p",
        "mcdpr-firmware",
        "--bin",
        "mcdpr-firmware",
        "--features",
        "board",
        "--target",
        TARGET,
        "--",
        "-D",
        "warnings",
    ])
}

/// Makes sure that the standard library for a target, the chip's for one, is there.
pub(crate) fn ensure_target(target: &str) -> Result<(), String> {
    if target_is_installed(target) {
        return Ok(());
    }
    let added = run(Command::new("rustup").args(["target", "add", target]));
    if added.is_ok() && target_is_installed(target) {
        return Ok(());
    }
    Err(format!(
        "xtask: the Rust target {target} is not installed and `rustup target add {target}` did not \
         bring it.\nOther ways: your distribution's package of Rust's standard library for that \
         target; or its rustc with its rust-src package, then\n  RUSTC_BOOTSTRAP=1 cargo fw \
         -Zbuild-std=core"
    ))
}

fn target_is_installed(target: &str) -> bool {
    let sysroot = Command::new("rustc").args(["--print", "sysroot"]).output();
    let Ok(sysroot) = sysroot else { return false };
    let sysroot = PathBuf::from(String::from_utf8_lossy(&sysroot.stdout).trim());
    let libraries = sysroot.join("lib/rustlib").join(target).join("lib");
    std::fs::read_dir(libraries).is_ok_and(|mut entries| {
        entries.any(|entry| {
            entry.is_ok_and(|entry| entry.file_name().to_string_lossy().starts_with("libcore"))
        })
    })
}

/// Where the firmware's file is.
pub(crate) fn elf_path() -> PathBuf {
    let root = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| "target".into(), PathBuf::from);
    root.join(TARGET).join("firmware").join("mcdpr-firmware")
}

fn check(image: &[u8]) -> Result<(), String> {
    let elf: ElfFile32 = ElfFile32::parse(image).map_err(|error| format!("not an ELF: {error}"))?;
    let (mut flash, mut ram) = (0, 0);
    for section in elf.sections() {
        let SectionFlags::Elf { sh_flags } = section.flags() else {
            continue;
        };
        if sh_flags & u64::from(object::elf::SHF_ALLOC) == 0 {
            continue;
        }
        let in_ram = section.address() >= 0x2000_0000;
        let has_bytes = section.file_range().is_some_and(|(_, size)| size > 0);
        if in_ram {
            ram += section.size();
        }
        // What is in RAM with contents is copied there from flash.
        if has_bytes {
            flash += section.size();
        }
    }
    println!(
        "firmware: {flash} bytes of flash (budget {FLASH_BUDGET}), {ram} of static RAM (budget {RAM_BUDGET})"
    );
    let floats: Vec<_> = elf
        .symbols()
        .filter_map(|symbol| symbol.name().ok())
        .filter(|name| is_float_helper(name))
        .collect();
    if !floats.is_empty() {
        return Err(format!(
            "firmware: floating point got in: {}",
            floats.join(", ")
        ));
    }
    if flash == 0 || ram == 0 {
        return Err("firmware: the image has no sections: the measurement is wrong".to_owned());
    }
    if flash > FLASH_BUDGET || ram > RAM_BUDGET {
        return Err("firmware: over its budget".to_owned());
    }
    Ok(())
}

/// Names of the run-time ABI's floating point helpers (single, double, and conversions to them).
fn is_float_helper(name: &str) -> bool {
    const PREFIXES: [&str; 12] = [
        "__aeabi_f",
        "__aeabi_d",
        "__aeabi_cf",
        "__aeabi_cd",
        "__aeabi_i2",
        "__aeabi_ui2",
        "__aeabi_l2",
        "__aeabi_ul2",
        "__adddf",
        "__addsf",
        "__muldf",
        "__mulsf",
    ];
    PREFIXES.iter().any(|prefix| name.starts_with(prefix))
}

#[cfg(test)]
mod tests {
    use super::is_float_helper;

    #[test]
    fn float_helpers_are_reported_from_integer_ones() {
        for name in [
            "__aeabi_fmul",
            "__aeabi_dadd",
            "__aeabi_ui2d",
            "__aeabi_d2iz",
            "__addsf3",
        ] {
            assert!(is_float_helper(name), "{name}");
        }
        for name in [
            "__aeabi_ldivmod",
            "__aeabi_uidiv",
            "__aeabi_memcpy",
            "__aeabi_lmul",
        ] {
            assert!(!is_float_helper(name), "{name}");
        }
    }
}
