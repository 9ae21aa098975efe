//! The playground: one folder of static files, with the robot as WebAssembly.

use crate::firmware::ensure_target;
use flate2::Compression;
use flate2::write::GzEncoder;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The target of a web page.
pub(crate) const TARGET: &str = "wasm32-unknown-unknown";
const PROFILE: &str = "playground";
/// The page's files, of which `page.html` names the others.
const PAGE: &str = "twin/src/page";
/// What takes the place of the server.
const HOST: &str = "playground/page/host.js";
/// Most bytes that a browser loads, compressed.
const MOST_BYTES: usize = 3_000_000;

/// The folder that [`build`] writes.
pub(crate) fn folder() -> PathBuf {
    target().join("playground")
}

fn target() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| "target".into(), PathBuf::from)
}

/// Builds it and says how large it is.
///
/// # Errors
/// What failed; that it is too large.
pub(crate) fn build(cargo: &str) -> Result<(), String> {
    ensure_target(TARGET)?;
    let mut command = Command::new(cargo);
    command
        .args(["build", "--locked", "--profile", PROFILE])
        .args(["--target", TARGET, "-p", "mcdpr-playground", "--lib"]);
    let built = crate::times::timed("the playground is built", || command.status());
    match built {
        Ok(status) if status.success() => {}
        Ok(status) => return Err(format!("the playground was not built ({status})")),
        Err(error) => return Err(format!("{cargo}: {error}")),
    }
    let wasm = target().join(TARGET).join(PROFILE);
    let wasm = wasm.join("mcdpr_playground.wasm");
    let sizes = assemble(&wasm, &folder()).map_err(|error| format!("the playground: {error}"))?;
    println!(
        "xtask: {}: open index.html; {} kB of WebAssembly, {} kB compressed, {} kB to load",
        folder().display(),
        sizes.wasm / 1000,
        sizes.packed / 1000,
        sizes.loaded / 1000
    );
    if sizes.loaded > MOST_BYTES {
        return Err(format!("the playground is larger than {MOST_BYTES} bytes"));
    }
    Ok(())
}

struct Sizes {
    wasm: usize,
    packed: usize,
    /// Both files as a server that compresses sends them.
    loaded: usize,
}

fn assemble(wasm: &Path, folder: &Path) -> std::io::Result<Sizes> {
    let module = fs::read(wasm)?;
    let packed = packed(&module)?;
    let script = format!("const PLAYGROUND_WASM = '{}';\n", base64(&packed));
    let index = page(Path::new(PAGE), &fs::read_to_string(HOST)?)?;
    fs::create_dir_all(folder)?;
    // A script, not a file to fetch: a page that is opened from a disk may not fetch.
    fs::write(folder.join("mcdpr.js"), &script)?;
    fs::write(folder.join("index.html"), &index)?;
    let loaded = packed_size(script.as_bytes())? + packed_size(index.as_bytes())?;
    Ok(Sizes {
        wasm: module.len(),
        packed: packed.len(),
        loaded,
    })
}

/// The page with its parts, and with a script in the place of the server.
fn page(parts: &Path, host: &str) -> std::io::Result<String> {
    let mut page = fs::read_to_string(parts.join("page.html"))?;
    for entry in fs::read_dir(parts)? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if name != "page.html" && entry.file_type()?.is_file() {
            let text = fs::read_to_string(entry.path())?;
            page = page.replace(&format!("/*{name}*/"), &text);
        }
    }
    let page = page.replace("/*host*/", host);
    Ok(page.replacen(
        "<script>",
        "<script src=\"mcdpr.js\"></script>\n<script>",
        1,
    ))
}

fn packed(bytes: &[u8]) -> std::io::Result<Vec<u8>> {
    let mut packer = GzEncoder::new(Vec::new(), Compression::best());
    packer.write_all(bytes)?;
    packer.finish()
}

fn packed_size(bytes: &[u8]) -> std::io::Result<usize> {
    packed(bytes).map(|packed| packed.len())
}

/// Letters of base64 (RFC 4648).
const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

fn base64(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let byte = |index: usize| chunk.get(index).copied().unwrap_or(0);
        let bits = u32::from_be_bytes([0, byte(0), byte(1), byte(2)]);
        for place in 0..4 {
            if place > chunk.len() {
                text.push('=');
                continue;
            }
            let index = (bits >> (18 - 6 * place)) & 63;
            text.push(char::from(LETTERS[index as usize]));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    #[test]
    fn base64_is_that_of_rfc_4648() {
        for (bytes, text) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
        ] {
            assert_eq!(super::base64(bytes.as_bytes()), text);
        }
    }
}
