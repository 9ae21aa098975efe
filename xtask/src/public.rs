//! Public items that nothing outside their crate names.
//!
//! The compiler finds dead code only among what is not public. So `pub` is for what another crate, a program, a
//! test from outside or an example in the documentation names; all else is `pub(crate)` or less. A type may
//! also be public because a public signature holds it.
//!
//! This goes by names alone: two items of one name stand in for each other. It finds less than there
//! is, and nothing that is not there.

use crate::source::{code, is_name, is_test, sources, without_comments, words};
use std::collections::BTreeSet;
use std::path::Path;

/// Libraries, and folders in the workspace that may name their items.
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
    "tests",
];
/// Folders of a crate that are crates of their own.
const OUTSIDE: [&str; 5] = ["tests", "benches", "examples", "fuzz_targets", "src/board"];

/// A public item.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Item {
    kind: &'static str,
    name: String,
}

/// What the files of one library say.
#[derive(Default)]
struct Library {
    /// Public items, by their file.
    items: Vec<(String, Item)>,
    /// Names that public signatures hold.
    signatures: BTreeSet<String>,
    /// Names in the code, tests included.
    names: BTreeSet<String>,
    /// Names in examples of the documentation, which are compiled as another crate.
    examples: BTreeSet<String>,
}

/// Looks for public items that nothing outside of their crate names.
///
/// # Errors
/// The items, with their files.
pub(crate) fn check() -> Result<(), String> {
    let mut libraries = Vec::new();
    let mut outside = BTreeSet::new();
    for name in CRATES {
        let mut library = Library::default();
        for (path, text) in sources(&Path::new(name).join("src"))? {
            if path == Path::new("main.rs") {
                outside.extend(names(&text));
            } else {
                library.read(&path.display().to_string(), &text, is_test(&path));
            }
        }
        libraries.push((name, library));
    }
    for folder in CRATES.iter().chain(&["fuzz"]) {
        for part in OUTSIDE {
            let folder = Path::new(folder).join(part);
            if folder.is_dir() {
                for (_, text) in sources(&folder)? {
                    outside.extend(names(&text));
                }
            }
        }
    }
    let mut wrong = Vec::new();
    for (name, library) in &libraries {
        let others = libraries.iter().filter(|(other, _)| other != name);
        let others: Vec<_> = others.map(|(_, other)| &other.names).collect();
        let is_named =
            |item: &str| outside.contains(item) || others.iter().any(|names| names.contains(item));
        let unused = library.unused(is_named);
        println!(
            "seams: {name}: {} public items, {} of them unused outside the crate",
            library.items.len(),
            unused.len()
        );
        wrong.extend(unused.iter().map(|(file, item)| {
            format!(
                "seams: {name}/src/{file}: `pub {} {}`: nothing outside the crate names it: make it pub(crate)",
                item.kind, item.name
            )
        }));
    }
    if wrong.is_empty() {
        Ok(())
    } else {
        Err(wrong.join("\n"))
    }
}

impl Library {
    fn read(&mut self, file: &str, text: &str, is_test: bool) {
        self.names.extend(names(text));
        self.examples.extend(examples(text));
        if is_test {
            return;
        }
        let words = words(&code(text));
        for (at, word) in words.iter().enumerate() {
            if word == "pub" {
                public(&words[at + 1..], |item| {
                    self.items.push((file.to_owned(), item));
                });
                self.signatures.extend(signature(&words[at + 1..]));
            } else if word == "type" {
                // Of an implementation: the type that a trait's user sees.
                self.signatures
                    .extend(until(&words[at + 1..], &[";"]).iter().skip(1).cloned());
            }
        }
    }

    fn unused(&self, is_named: impl Fn(&str) -> bool) -> Vec<&(String, Item)> {
        let is_unused = |item: &Item| {
            let is_type = matches!(item.kind, "struct" | "enum" | "trait" | "type" | "use");
            !(is_named(&item.name)
                || self.examples.contains(&item.name)
                || (is_type && self.signatures.contains(&item.name)))
        };
        self.items
            .iter()
            .filter(|(_, item)| is_unused(item))
            .collect()
    }
}

/// Names in the code of a file.
fn names(text: &str) -> impl Iterator<Item = String> {
    words(&without_comments(text))
        .into_iter()
        .filter(|word| is_name(word))
}

/// Names in the examples of a file's documentation.
fn examples(text: &str) -> BTreeSet<String> {
    let mut inside = false;
    let mut out = BTreeSet::new();
    for line in text.lines().map(str::trim_start) {
        let Some(line) = line.strip_prefix("///").or(line.strip_prefix("//!")) else {
            inside = false;
            continue;
        };
        if line.trim_start().starts_with("```") {
            inside = !inside;
        } else if inside {
            out.extend(words(line).into_iter().filter(|word| is_name(word)));
        }
    }
    out
}

/// Gives the items that the words behind a `pub` declare.
fn public(words: &[String], mut give: impl FnMut(Item)) {
    let words: Vec<&str> = words.iter().take(400).map(String::as_str).collect();
    let mut at = 0;
    loop {
        let word = words.get(at).copied().unwrap_or_default();
        let next = words.get(at + 1).copied().unwrap_or_default();
        let kind = match word {
            "const" if matches!(next, "fn" | "unsafe" | "async") => None,
            "async" | "unsafe" | "extern" => None,
            "fn" => Some("fn"),
            "struct" => Some("struct"),
            "enum" => Some("enum"),
            "trait" => Some("trait"),
            "type" => Some("type"),
            "const" => Some("const"),
            "static" => Some("static"),
            "mod" => Some("mod"),
            "use" => {
                for name in leaves(&words[at + 1..]) {
                    give(Item { kind: "use", name });
                }
                return;
            }
            // A field, or `pub(crate)`.
            _ => return,
        };
        if let Some(kind) = kind {
            if is_name(next) {
                let name = next.to_owned();
                give(Item { kind, name });
            }
            return;
        }
        at += 1;
    }
}

/// The names that a `use` brings in, from the words behind it.
fn leaves(words: &[&str]) -> Vec<String> {
    let end = words.iter().position(|word| *word == ";");
    let words = &words[..end.unwrap_or(words.len())];
    let ends = |next: Option<&&str>| matches!(next.copied(), None | Some("," | "}"));
    words
        .iter()
        .enumerate()
        .filter(|(at, word)| is_name(word) && **word != "self" && ends(words.get(at + 1)))
        .map(|(_, word)| (*word).to_owned())
        .collect()
}

/// The names that the interface of the item or field behind a `pub` holds, its own name left out.
fn signature(words: &[String]) -> Vec<String> {
    let Some(first) = words.first().map(String::as_str) else {
        return Vec::new();
    };
    let ends: &[&str] = match first {
        "(" | "use" | "mod" => return Vec::new(),
        "struct" => &["{", "(", ";"],
        "enum" | "trait" => &["}"],
        "const" | "static" if words.get(1).is_none_or(|word| word != "fn") => &["="],
        "fn" | "const" | "async" | "unsafe" => &["{", ";"],
        "type" => &[";"],
        // A field, named or not.
        _ => &[","],
    };
    let is_item = matches!(
        first,
        "struct" | "enum" | "trait" | "const" | "static" | "fn" | "async" | "unsafe" | "type"
    );
    let mut held = until(words, ends).iter().filter(|word| is_name(word));
    if is_item {
        let _ = held.find(|word| {
            !matches!(
                word.as_str(),
                "struct"
                    | "enum"
                    | "trait"
                    | "const"
                    | "static"
                    | "fn"
                    | "async"
                    | "unsafe"
                    | "type"
            )
        });
    }
    held.cloned().collect()
}

/// The words before the first of `ends` that is in no bracket opened here.
fn until<'a>(words: &'a [String], ends: &[&str]) -> &'a [String] {
    // Commas part fields, and arguments of types.
    let with_angles = ends.contains(&",");
    let mut depth = 0_u32;
    let mut before = "";
    for (at, word) in words.iter().enumerate() {
        let word = word.as_str();
        let opens = matches!(word, "(" | "[" | "{") || (with_angles && word == "<");
        let closes =
            matches!(word, ")" | "]" | "}") || (with_angles && word == ">" && before != "-");
        if depth == 0 && (closes || ends.contains(&word)) {
            return &words[..at];
        }
        if closes && depth == 1 && ends.contains(&word) {
            return &words[..at];
        }
        depth = depth + u32::from(opens) - u32::from(closes);
        before = word;
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unused(text: &str, named: &[&str]) -> Vec<String> {
        let mut library = Library::default();
        library.read("lib.rs", text, false);
        let found = library.unused(|name| named.contains(&name));
        found.iter().map(|(_, item)| item.name.clone()).collect()
    }

    #[test]
    fn what_nothing_outside_names_is_found() {
        let text = "pub mod a; pub use a::{B, c as d}; pub(crate) fn e() {} pub const fn f() {} \
                    pub const G: u8 = 1; pub struct H { pub i: u8 } impl H { pub fn j(&self) {} } fn k() {} \
                    #[cfg(test)] mod tests { pub fn l() {} }";
        assert_eq!(unused(text, &[]), ["a", "B", "d", "f", "G", "H", "j"]);
        assert_eq!(unused(text, &["a", "d", "G", "H"]), ["B", "f", "j"]);
    }

    #[test]
    fn a_type_in_a_public_signature_is_used() {
        let text = "pub struct A; pub struct B; pub struct C; pub struct D; pub struct E; pub struct F; pub struct G; \
                    pub fn f(a: A, n: [u8; 3]) -> Result<B, u8> { C } pub struct T(pub [D; 2], u8); \
                    pub struct W { pub w: X<u8, Y>, z: Z } pub struct Y; pub struct Z; \
                    pub enum U { One(E), Two { x: F } } pub const V: G = G;";
        let named = ["f", "T", "U", "V", "W"];
        assert_eq!(unused(text, &named), ["C", "Z"]);
    }

    #[test]
    fn an_example_uses_what_it_names() {
        let text =
            "/// As in\n/// ```\n/// a::f();\n/// ```\n/// and g\npub fn f() {}\npub fn g() {}";
        assert_eq!(unused(text, &[]), ["g"]);
    }
}
