//! The seams between modules: no ring of a crate's own modules, checked by reading its sources.
//!
//! A module of a crate is a file or folder directly under `src`. One module uses another where its
//! code outside of tests names `crate::other`, or reaches it by `super`. Tests stand above all modules:
//! what they use makes no ring.
//!
//! Some crates must also run where there is no operating system. That they compile there is not
//! enough, since the standard library has files and clocks that only fail when they are used: their
//! code must not name them.
//!
//! What simulates must give the same bits in the program and in a browser, so it must not call the
//! standard library's elementary functions, which are those of the system.

use crate::source::{code, is_name, is_test, sources, words};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Where the modules of the workspace's crates are.
const SOURCES: [&str; 16] = [
    "protocol/src",
    "kinematics/src",
    "vision/src",
    "core/src",
    "calibration/src",
    "python/src",
    "firmware/src",
    "firmware/src/board",
    "simulator/src",
    "emulator/src",
    "twin/src",
    "playground/src",
    "host/src",
    "tests/src",
    "ros/src",
    "xtask/src",
];

/// Where the modules of crates without an operating system are.
const WITHOUT_SYSTEM: [&str; 4] = ["core/src", "calibration/src", "twin/src", "playground/src"];
/// What the standard library has of an operating system.
const SYSTEM: [&str; 5] = ["env", "fs", "net", "process", "thread"];
/// The same of `std::time`.
const CLOCKS: [&str; 3] = ["Instant", "SystemTime", "*"];

/// Where the modules of crates are whose numbers must not depend on the system.
const SAME_BITS: [&str; 5] = [
    "kinematics/src",
    "core/src",
    "simulator/src",
    "twin/src",
    "playground/src",
];
/// The standard library's functions whose last bits differ from system to system.
const ELEMENTARY: [&str; 22] = [
    "sin", "cos", "tan", "sin_cos", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh",
    "asinh", "acosh", "atanh", "exp", "exp2", "exp_m1", "ln", "ln_1p", "powf", "cbrt", "hypot",
];

/// Which files of a module use which other module, by the module that uses and the one that is used.
type Ties = BTreeMap<String, BTreeMap<String, BTreeSet<String>>>;

/// Looks for rings in every crate of the workspace.
///
/// # Errors
/// The rings, with the files that tie them.
pub(crate) fn check() -> Result<(), String> {
    let mut wrong = Vec::new();
    for name in SOURCES {
        let ties = ties_of(Path::new(name))?;
        let rings = rings(&ties);
        println!(
            "seams: {name}: {} modules, {} of them in rings",
            ties.len(),
            rings.iter().map(Vec::len).sum::<usize>()
        );
        wrong.extend(rings.iter().map(|ring| describe(name, ring, &ties)));
    }
    for name in WITHOUT_SYSTEM {
        for (path, text) in sources(Path::new(name))? {
            let used = system_parts(&code(&text));
            if !is_test(&path) && !used.is_empty() {
                wrong.push(format!(
                    "seams: {name}/{} uses {}: what needs an operating system comes in as an argument",
                    path.display(),
                    used.join(", ")
                ));
            }
        }
    }
    for name in SAME_BITS {
        for (path, text) in sources(Path::new(name))? {
            let used = elementary(&code(&text));
            if !is_test(&path) && !used.is_empty() {
                wrong.push(format!(
                    "seams: {name}/{} calls {} of the standard library: take it from libm, whose bits are \
                     the same everywhere",
                    path.display(),
                    used.join(", ")
                ));
            }
        }
    }
    if wrong.is_empty() {
        Ok(())
    } else {
        Err(wrong.join("\n"))
    }
}

/// Describes a ring: its modules, and the files that tie them.
fn describe(name: &str, ring: &[String], ties: &Ties) -> String {
    let mut out = format!(
        "seams: modules of {name} use each other in a ring: {}\n  move what ties them to where both may \
         use it:",
        ring.join(", ")
    );
    for from in ring {
        for (to, files) in ties.get(from).into_iter().flatten() {
            if to != from && ring.contains(to) {
                let files: Vec<_> = files.iter().map(String::as_str).collect();
                out += &format!("\n  {from} uses {to} in {}", files.join(", "));
            }
        }
    }
    out
}

/// Parts of the operating system that code names.
fn system_parts(code: &str) -> Vec<String> {
    let mut used: Vec<_> = paths(code)
        .into_iter()
        .filter(|path| path.first().is_some_and(|first| first == "std"))
        .filter(|path| match path.get(1).map(String::as_str) {
            Some("time") => path
                .get(2)
                .is_none_or(|part| CLOCKS.contains(&part.as_str())),
            Some(part) => SYSTEM.contains(&part),
            None => false,
        })
        .map(|path| path.join("::"))
        .collect();
    used.sort();
    used.dedup();
    used
}

/// Elementary functions that code calls as methods or by their type.
fn elementary(code: &str) -> Vec<String> {
    let words = words(code);
    let calls = words.windows(3).filter_map(|three| match three {
        [dot, name, open] if dot == "." && open == "(" => Some(name),
        [kind, colons, name] if (kind == "f64" || kind == "f32") && colons == "::" => Some(name),
        _ => None,
    });
    let used: BTreeSet<_> = calls
        .filter(|name| ELEMENTARY.contains(&name.as_str()))
        .collect();
    used.into_iter().cloned().collect()
}

/// The ties between the modules under a `src` folder.
fn ties_of(src: &Path) -> Result<Ties, String> {
    let mut ties = Ties::new();
    for (path, text) in sources(src)? {
        read(&path, &text, &mut ties);
    }
    // Names that are no modules are items of the crate itself.
    let modules: BTreeSet<String> = ties.keys().cloned().collect();
    for used in ties.values_mut() {
        used.retain(|name, _| modules.contains(name));
    }
    Ok(ties)
}

/// Adds what one file uses; `path` is relative to `src`.
fn read(path: &Path, text: &str, ties: &mut Ties) {
    let place = module_of(path);
    let Some(own) = place.first() else { return };
    let file = path.display().to_string();
    let used = ties.entry(own.clone()).or_default();
    if is_test(path) {
        return;
    }
    for name in used_modules(&place, &code(text)) {
        if name != *own {
            used.entry(name).or_default().insert(file.clone());
        }
    }
}

/// The module that a file is, from the crate's root on; none for the root itself.
fn module_of(path: &Path) -> Vec<String> {
    let path = path.with_extension("");
    let mut parts: Vec<String> = path
        .components()
        .map(|part| part.as_os_str().to_string_lossy().into_owned())
        .collect();
    if parts.last().is_some_and(|last| last == "mod") {
        parts.pop();
    }
    if parts.len() == 1 && matches!(parts[0].as_str(), "lib" | "main") {
        parts.clear();
    }
    parts
}

/// The top-level modules that the code of the module at `place` names.
fn used_modules(place: &[String], code: &str) -> BTreeSet<String> {
    let mut out = BTreeSet::new();
    for path in paths(code) {
        let mut parts = path.iter().map(String::as_str).peekable();
        let mut up = 0;
        if parts.next_if_eq(&"crate").is_some() {
            up = place.len();
        } else {
            parts.next_if_eq(&"self");
            while parts.next_if_eq(&"super").is_some() {
                up += 1;
            }
            if up == 0 {
                continue;
            }
        }
        // Inside of inline modules `super` reaches less far; those are tests, which are left out.
        if up == place.len()
            && let Some(name) = parts.next()
        {
            out.insert(name.to_owned());
        }
    }
    out
}

/// Every path in the code that begins with `crate`, `self`, `super` or `std`; a group in braces gives one path
/// for each of its parts.
fn paths(code: &str) -> Vec<Vec<String>> {
    let words = words(code);
    let mut out = Vec::new();
    let mut at = 0;
    while at < words.len() {
        let begins = matches!(words[at].as_str(), "crate" | "super" | "self" | "std");
        let inside = at > 0 && words[at - 1] == "::";
        if begins && !inside && words.get(at + 1).is_some_and(|word| word == "::") {
            tree(&words, &mut at, &[], &mut out);
        } else {
            at += 1;
        }
    }
    out
}

/// Reads one path with its groups from the words, on top of `before`.
fn tree(words: &[String], at: &mut usize, before: &[String], out: &mut Vec<Vec<String>>) {
    let mut path = before.to_vec();
    while let Some(word) = words.get(*at) {
        if word == "{" {
            *at += 1;
            while words.get(*at).is_some_and(|word| word != "}") {
                if words[*at] == "," {
                    *at += 1;
                } else {
                    tree(words, at, &path, out);
                }
            }
            *at += 1;
            return;
        }
        if !is_name(word) && word != "*" {
            *at += 1;
            break;
        }
        path.push(word.clone());
        *at += 1;
        if words.get(*at).is_some_and(|word| word == "as") {
            *at += 2;
        }
        if words.get(*at).is_some_and(|word| word == "::") {
            *at += 1;
        } else {
            break;
        }
    }
    out.push(path);
}

/// The groups of more than one module that use each other, directly or through others.
fn rings(ties: &Ties) -> Vec<Vec<String>> {
    let reach = |from: &str| {
        let mut seen = BTreeSet::new();
        let mut waiting = vec![from.to_owned()];
        while let Some(name) = waiting.pop() {
            for next in ties.get(&name).into_iter().flat_map(BTreeMap::keys) {
                if seen.insert(next.clone()) {
                    waiting.push(next.clone());
                }
            }
        }
        seen
    };
    let reached: BTreeMap<&String, BTreeSet<String>> =
        ties.keys().map(|name| (name, reach(name))).collect();
    let mut done = BTreeSet::new();
    let mut out = Vec::new();
    for (name, seen) in &reached {
        if !seen.contains(*name) || !done.insert((*name).clone()) {
            continue;
        }
        let mut ring = vec![(*name).clone()];
        for other in seen {
            let back = reached.get(other).is_some_and(|seen| seen.contains(*name));
            if back && done.insert(other.clone()) {
                ring.push(other.clone());
            }
        }
        out.push(ring);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ties(files: &[(&str, &str)]) -> Ties {
        let mut ties = Ties::new();
        for (path, text) in files {
            read(Path::new(path), text, &mut ties);
        }
        ties
    }

    #[test]
    fn a_ring_is_found_and_named_with_its_ties() {
        let ties = ties(&[
            (
                "lib.rs",
                "pub mod robot; pub mod link; pub mod run; pub mod page;",
            ),
            ("robot/mod.rs", "pub struct Robot;"),
            (
                "link.rs",
                "use crate::robot::Robot;\nuse crate::run::Saved;",
            ),
            ("run/mod.rs", "mod session;"),
            ("run/session.rs", "use super::super::link::{Client, Link};"),
            ("page.rs", "use crate::{link, run};"),
        ]);
        let found = rings(&ties);
        assert_eq!(found, [["link".to_owned(), "run".to_owned()]]);
        let text = describe("host", &found[0], &ties);
        assert!(text.contains("link uses run in link.rs"), "{text}");
        assert!(text.contains("run uses link in run/session.rs"), "{text}");
        assert!(!text.contains("robot") && !text.contains("page"), "{text}");
    }

    #[test]
    fn a_ring_through_others_is_one_ring() {
        let ties = ties(&[
            ("a.rs", "fn f() { crate::b::g(); }"),
            ("b.rs", "use super::c;"),
            ("c.rs", "type T = Vec<crate::a::S>;"),
        ]);
        assert_eq!(rings(&ties).concat(), ["a", "b", "c"]);
    }

    #[test]
    fn groups_are_read_in_full_and_own_parts_are_not_counted() {
        let place = ["run".to_owned(), "session".to_owned()];
        let text = "use crate::{link::{Client as C, Link}, motion::*, run::Homing};\n\
                    use super::saved::Saved; use self::inner::X; use mcdpr::crate_like;";
        let used: Vec<_> = used_modules(&place, &code(text)).into_iter().collect();
        assert_eq!(used, ["link", "motion", "run"]);
    }

    #[test]
    fn comments_texts_and_tests_do_not_count() {
        let text = r##"
            //! [`crate::doc`]
            const A: &str = "crate::text \" crate::still";
            const B: &str = r#"crate::raw " {"#; // crate::comment
            const C: char = '{';
            #[cfg(test)]
            use crate::only_tests;
            #[cfg(test)]
            mod tests { fn f() { if true { crate::also_tests::f() } } }
            fn f() { crate::counted::f() }
        "##;
        let used: Vec<_> = used_modules(&["x".to_owned()], &code(text))
            .into_iter()
            .collect();
        assert_eq!(used, ["counted"]);
    }

    #[test]
    fn elementary_functions_of_the_system_are_found_and_those_of_libm_are_not() {
        let text = "#[cfg(test)] mod tests { fn f() { 1f64.tan(); } }\n\
                    // x.cos()\n\
                    fn f(x: f64, a: Angle) -> f64 { libm::sin(x) + x.ln() + a.sin + [x].map(f64::exp)[0] }";
        assert_eq!(elementary(&code(text)), ["exp", "ln"]);
    }

    #[test]
    fn files_and_clocks_are_found_and_lengths_of_time_are_not() {
        let text = "use std::{fs, fmt}; use std::time::{Duration, Instant}; use std::path::Path;\n\
                    #[cfg(test)] mod tests { use std::thread; }\n\
                    fn f() { std::env::var_os(\"A\"); }";
        let wanted = ["std::env::var_os", "std::fs", "std::time::Instant"];
        assert_eq!(system_parts(&code(text)), wanted);
    }
}
