//! Reading Rust sources as words: enough to see which module names which, without a compiler.

use std::path::{Path, PathBuf};

/// The source files under a folder, by their path in it, with their texts.
pub(crate) fn sources(src: &Path) -> Result<Vec<(PathBuf, String)>, String> {
    let mut out = Vec::new();
    let mut waiting = vec![src.to_path_buf()];
    while let Some(folder) = waiting.pop() {
        let failed = |error| format!("{}: {error}", folder.display());
        for entry in std::fs::read_dir(&folder).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            if path.is_dir() {
                // Under `src`, a program of its own, as the firmware's.
                if !(src.ends_with("src") && path.join("main.rs").exists()) {
                    waiting.push(path);
                }
            } else if path.extension().is_some_and(|kind| kind == "rs") {
                let text = std::fs::read_to_string(&path)
                    .map_err(|error| format!("{}: {error}", path.display()))?;
                let relative = path.strip_prefix(src).unwrap_or(&path);
                out.push((relative.to_path_buf(), text));
            }
        }
    }
    Ok(out)
}

/// Whether a file holds tests only.
pub(crate) fn is_test(path: &Path) -> bool {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    stem == "tests"
        || stem.ends_with("_tests")
        || path.components().any(|part| part.as_os_str() == "tests")
}

pub(crate) fn is_name(word: &str) -> bool {
    word.starts_with(|c: char| c.is_alphabetic() || c == '_')
}

/// Names, `::`, and every other character that is not white space.
pub(crate) fn words(code: &str) -> Vec<String> {
    let mut out = Vec::new();
    let mut rest = code.chars().peekable();
    while let Some(c) = rest.next() {
        if c.is_alphanumeric() || c == '_' {
            let mut name = String::from(c);
            while let Some(c) = rest.next_if(|c| c.is_alphanumeric() || *c == '_') {
                name.push(c);
            }
            out.push(name);
        } else if c == ':' && rest.next_if_eq(&':').is_some() {
            out.push("::".to_owned());
        } else if !c.is_whitespace() {
            out.push(c.to_string());
        }
    }
    out
}

/// The code of a file without comments, texts and what is compiled for tests only.
pub(crate) fn code(text: &str) -> String {
    let mut plain = without_comments(text);
    while let Some(start) = plain.find("#[cfg(test)]") {
        let rest = &plain[start..];
        // The item ends with its block, or with a semicolon before any block.
        let open = rest.find('{').unwrap_or(rest.len());
        let end = match rest.find(';') {
            Some(end) if end < open => end + 1,
            _ => block_end(rest, open),
        };
        plain.replace_range(start..start + end, "");
    }
    plain
}

/// Where the block that opens at `open` ends.
fn block_end(text: &str, open: usize) -> usize {
    let mut depth = 0;
    for (at, c) in text.char_indices().skip_while(|(at, _)| *at < open) {
        match c {
            '{' => depth += 1,
            '}' if depth == 1 => return at + 1,
            '}' => depth -= 1,
            _ => {}
        }
    }
    text.len()
}

/// A file with a space in place of each comment, text and bracket character.
pub(crate) fn without_comments(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        let in_name = out.ends_with(|c: char| c.is_alphanumeric() || c == '_');
        match skipped(rest, in_name) {
            0 => {
                out.push(c);
                rest = &rest[c.len_utf8()..];
            }
            bytes => {
                out.push(' ');
                rest = &rest[bytes..];
            }
        }
    }
    out
}

/// Bytes of the comment, text or bracket character that the code begins with; 0 for anything else.
fn skipped(code: &str, in_name: bool) -> usize {
    if code.starts_with("//") {
        return code.find('\n').unwrap_or(code.len());
    }
    if code.starts_with("/*") {
        return code.find("*/").map_or(code.len(), |end| end + 2);
    }
    if let Some(opened) = code.strip_prefix('r').filter(|_| !in_name) {
        let hashes = opened.len() - opened.trim_start_matches('#').len();
        if opened[hashes..].starts_with('"') {
            let close = format!("\"{}", "#".repeat(hashes));
            let body = 2 + hashes;
            let end = code[body..].find(&close);
            return end.map_or(code.len(), |end| body + end + close.len());
        }
    }
    if code.starts_with('"') {
        let mut escaped = false;
        for (at, c) in code.char_indices().skip(1) {
            match c {
                _ if escaped => escaped = false,
                '\\' => escaped = true,
                '"' => return at + 1,
                _ => {}
            }
        }
        return code.len();
    }
    let brackets = ["'\"'", "'{'", "'}'", "'\\''"];
    let found = brackets.iter().find(|text| code.starts_with(**text));
    found.map_or(0, |text| text.len())
}
