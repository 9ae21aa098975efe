//! How long production functions are.

use crate::source::{code, is_test, sources, words};
use std::path::Path;

/// Folders whose functions are measured.
const CRATES: [&str; 13] = [
    "protocol",
    "kinematics",
    "vision",
    "core",
    "calibration",
    "firmware",
    "simulator",
    "emulator",
    "twin",
    "playground",
    "host",
    "python",
    "xtask",
];
/// Functions that are printed.
const PRINTED: usize = 10;

/// A function.
struct Function {
    name: String,
    file: String,
    /// Lines of code, from `fn` to the closing brace; comments and empty lines are not counted.
    lines: usize,
}

/// Prints the longest functions that are not tests.
///
/// # Errors
/// Where a source cannot be read.
pub(crate) fn print_longest() -> Result<(), String> {
    let mut all = Vec::new();
    for name in CRATES {
        for (path, text) in sources(&Path::new(name).join("src"))? {
            if is_test(&path) {
                continue;
            }
            let file = format!("{name}/src/{}", path.display());
            let found = functions(&code(&text)).into_iter();
            all.extend(found.map(|(name, lines)| Function {
                name,
                file: file.clone(),
                lines,
            }));
        }
    }
    all.sort_by_key(|function| std::cmp::Reverse(function.lines));
    let over = all.iter().filter(|function| function.lines > 100).count();
    println!(
        "{} functions, {over} over 100 lines of code; the longest:",
        all.len()
    );
    for Function { name, file, lines } in all.iter().take(PRINTED) {
        println!("{lines:>5}  {name}  {file}");
    }
    Ok(())
}

/// Names of functions with their lines of code.
fn functions(code: &str) -> Vec<(String, usize)> {
    let mut out = Vec::new();
    let mut open: Vec<(String, usize, usize)> = Vec::new();
    let mut waiting: Option<(String, usize)> = None;
    let mut depth = 0;
    // Brackets of a signature: an array type holds a semicolon.
    let mut inside = 0;
    let full = code.lines().filter(|line| !line.trim().is_empty());
    for (number, line) in full.enumerate() {
        let words = words(line);
        for (at, word) in words.iter().enumerate() {
            match word.as_str() {
                "fn" => {
                    if let Some(name) = words.get(at + 1).filter(|name| name.as_str() != "(") {
                        waiting = Some((name.clone(), number));
                        inside = 0;
                    }
                }
                "(" | "[" => inside += 1,
                ")" | "]" => inside -= 1,
                // A signature without a body.
                ";" if inside == 0 => waiting = None,
                "{" => {
                    depth += 1;
                    if inside == 0
                        && let Some((name, begin)) = waiting.take()
                    {
                        open.push((name, begin, depth));
                        inside = 0;
                    }
                }
                "}" => {
                    if let Some((name, begin, _)) = open.pop_if(|(_, _, at)| *at == depth) {
                        out.push((name, number - begin + 1));
                    }
                    depth -= 1;
                }
                _ => {}
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn functions_are_measured_without_comments_and_nested_ones_by_themselves() {
        let text = "fn a(x: [u8; 2]) -> u8 {\n    // why\n\n    fn b() {}\n    x[0]\n}\ntrait T {\n    fn c();\n    fn d() {\n    }\n}\n";
        let found = functions(&code(text));
        let wanted = [("b", 1), ("a", 4), ("d", 2)];
        assert_eq!(found, wanted.map(|(name, lines)| (name.to_owned(), lines)));
    }
}
