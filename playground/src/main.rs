//! Puts the playground together: the page, and its WebAssembly as a script that also opens from a disk.
//!
//! `cargo xtask playground` builds the WebAssembly and calls this.

use flate2::Compression;
use flate2::write::GzEncoder;
use std::fs;
use std::io::Write as _;
use std::path::Path;
use std::process::ExitCode;

/// Letters of base64.
const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

fn main() -> ExitCode {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let [wasm, folder] = arguments.as_slice() else {
        eprintln!("mcdpr-playground needs the WebAssembly's file and a folder");
        return ExitCode::from(2);
    };
    match assemble(Path::new(wasm), Path::new(folder)) {
        Ok(words) => {
            println!("{words}");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("the playground cannot be written: {error}");
            ExitCode::FAILURE
        }
    }
}

fn assemble(wasm: &Path, folder: &Path) -> std::io::Result<String> {
    let module = fs::read(wasm)?;
    let mut packer = GzEncoder::new(Vec::new(), Compression::best());
    packer.write_all(&module)?;
    let packed = packer.finish()?;
    let script = format!("const PLAYGROUND_WASM = '{}';\n", base64(&packed));
    // As a script, not as a file to fetch: a page that is opened from a disk may not fetch.
    let page = mcdpr_twin::page_with(include_str!("../page/host.js"));
    let (head, rest) = page.split_once("<script>").unwrap_or((&page, ""));
    let index = format!("{head}<script src=\"mcdpr.js\"></script>\n<script>{rest}");
    fs::create_dir_all(folder)?;
    fs::write(folder.join("mcdpr.js"), &script)?;
    fs::write(folder.join("index.html"), &index)?;
    let kb = |bytes: usize| bytes as f64 / 1000.0;
    Ok(format!(
        "{}: index.html {:.0} kB, mcdpr.js {:.0} kB (WebAssembly of {:.0} kB, compressed {:.0} kB)",
        folder.display(),
        kb(index.len()),
        kb(script.len()),
        kb(module.len()),
        kb(packed.len()),
    ))
}

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
