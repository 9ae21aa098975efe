//! The documentation does what it says: its commands run, its examples are accepted or refused as
//! stated, the files that it names are there.
#![cfg(unix)]

use mcdpr_tests::mcdpr;
use mcdpr_tests::process::Folder;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// Commands that a document shows and this test does not run, with the reason.
const NOT_RUN: &[(&str, &str)] = &[
    (
        "mcdpr sim --pty",
        "serves until it is interrupted; tests/tests/program.rs and camera.rs run it with a client",
    ),
    (
        "mcdpr flash --list",
        "needs the feature `flash` and a probe; tests/tests/doctor.rs runs what needs none",
    ),
    (
        "mcdpr flash target/",
        "needs a probe; tests/tests/doctor.rs runs what needs none",
    ),
    (
        "mcdpr serve",
        "serves until it is interrupted; tests/tests/page.rs looks at it in a browser",
    ),
    (
        "mcdpr ros",
        "serves until it is interrupted, and needs mcdpr-ros; `cargo xtask ros` runs it",
    ),
    (
        "mcdpr pick --objects 2 --serve",
        "keeps real time and a port; tests/tests/page.rs does it with a port of its own",
    ),
    (
        "mcdpr pick --robot lab-fast --scenes 300",
        "takes an hour; tests/tests/picking.rs runs ten of its scenes",
    ),
    (
        "mcdpr calibrate collect --target board --poses 8 --candidates 40 --serve",
        "keeps real time and a port; tests/tests/cockpit_setup.rs does it from the page",
    ),
    (
        "mcdpr run paper:table7 --serve",
        "keeps real time and a port; tests/tests/page.rs does it with a port of its own",
    ),
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap()
        .to_owned()
}

/// Name and text of every document.
fn documents() -> Vec<(String, String)> {
    let mut paths: Vec<_> = std::fs::read_dir(root().join("docs"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|end| end == "md"))
        .collect();
    paths.push(root().join("README.md"));
    paths.retain(|path| path.is_file());
    paths.sort();
    let read = |path: PathBuf| {
        let text = std::fs::read_to_string(&path).unwrap();
        let name = path.strip_prefix(root()).unwrap();
        (name.display().to_string(), text)
    };
    paths.into_iter().map(read).collect()
}

/// A fenced block: its language, the last line of text before it, its content.
struct Block {
    language: String,
    before: String,
    content: String,
}

fn blocks(text: &str) -> Vec<Block> {
    let mut found = Vec::new();
    let mut before = "";
    let mut open: Option<Block> = None;
    for line in text.lines() {
        match (line.trim_end().strip_prefix("```"), open.take()) {
            (Some(_), Some(block)) => found.push(block),
            (None, Some(mut block)) => {
                block.content += line;
                block.content += "\n";
                open = Some(block);
            }
            (Some(language), None) => {
                open = Some(Block {
                    language: language.to_owned(),
                    before: before.to_owned(),
                    content: String::new(),
                });
            }
            (None, None) if !line.trim().is_empty() => before = line,
            (None, None) => {}
        }
    }
    assert!(open.is_none(), "a fenced block has no end");
    found
}

/// The words of a line that stand in backticks.
fn quoted(line: &str) -> impl Iterator<Item = &str> {
    line.split('`').skip(1).step_by(2)
}

/// What stands behind the program's name, for a line that calls it.
fn arguments(line: &str) -> Option<&str> {
    ["cargo run --release --", "cargo run --release", "mcdpr"]
        .iter()
        .find_map(|call| line.strip_prefix(call))
        .filter(|rest| rest.is_empty() || rest.starts_with(' '))
}

/// Whether the reader must put something of theirs in: `PORT`, `FILE`, `<...>`.
fn has_placeholder(line: &str) -> bool {
    let command = line.split('#').next().unwrap_or_default();
    let mut words = command.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
    let is_capital = |word: &str| word.chars().all(|c| c.is_ascii_uppercase());
    let angle = command
        .split_once('<')
        .is_some_and(|(_, rest)| rest.contains('>'));
    angle || words.any(|word| word.len() > 1 && is_capital(word))
}

/// The commands of a document that can be run as they stand.
fn commands(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    for block in blocks(text) {
        if block.language != "sh" {
            continue;
        }
        for line in block.content.replace("\\\n", " ").lines() {
            let line = line.trim();
            let skipped = NOT_RUN.iter().any(|(command, _)| line.starts_with(command));
            if arguments(line).is_some() && !has_placeholder(line) && !skipped {
                found.push(line.to_owned());
            }
        }
    }
    found
}

/// Runs a line as its reader's shell would, with the program of this build.
fn run(line: &str, folder: &Path) -> Output {
    let program = mcdpr();
    let rest = arguments(line).unwrap();
    Command::new("sh")
        .args(["-c", &format!("\"$MCDPR\"{rest}")])
        .env("MCDPR", program.get_program())
        .current_dir(folder)
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

/// A folder as the reader has it: `robots/`, and the example files of the document.
fn reader_folder(name: &str, text: &str) -> Folder {
    let folder = Folder::new(&name.replace('/', "-"));
    copy(&root().join("robots"), &folder.path().join("robots"));
    let examples = ["toml", "text"];
    let blocks = blocks(text);
    let blocks = blocks.iter();
    for block in blocks.filter(|b| examples.contains(&b.language.as_str())) {
        let named = quoted(&block.before)
            .find(|word| [".toml", ".nc"].iter().any(|end| word.ends_with(end)));
        if let Some(file) = named.filter(|file| !file.contains('/')) {
            std::fs::write(folder.path().join(file), &block.content).unwrap();
        }
    }
    folder
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap().path();
        let target = to.join(entry.file_name().unwrap());
        if entry.is_dir() {
            copy(&entry, &target);
        } else {
            std::fs::copy(&entry, &target).unwrap();
        }
    }
}

/// Takes the next one, and holds nothing meanwhile.
fn next<T>(queue: &Mutex<impl Iterator<Item = T>>) -> Option<T> {
    queue.lock().unwrap().next()
}

#[test]
fn every_command_of_the_documentation_does_what_it_says() {
    let (ran, wrong) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let documents = Mutex::new(documents().into_iter());
    // A document's commands build on each other; documents do not.
    let work = || {
        while let Some((name, text)) = next(&documents) {
            let folder = reader_folder(&name, &text);
            for line in commands(&text) {
                let began = Instant::now();
                let output = run(&line, folder.path());
                println!("{:6.1} s  {name}: {line}", began.elapsed().as_secs_f64());
                let expected = i32::from(line.ends_with("# refused"));
                let message = String::from_utf8_lossy(&output.stderr);
                let code = output.status.code();
                if code != Some(expected) {
                    let what = format!("{name}: {line} ({code:?})\n{message}");
                    wrong.lock().unwrap().push(what);
                }
                ran.fetch_add(1, Ordering::Relaxed);
            }
        }
    };
    let workers = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(work);
        }
    });
    let (ran, wrong) = (ran.into_inner(), wrong.into_inner().unwrap());
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(ran >= 8, "only {ran} commands were found");
}

#[test]
fn the_task_document_has_every_built_in_task_and_its_examples() {
    let text = std::fs::read_to_string(root().join("docs/tasks.md")).unwrap();
    for (name, _) in mcdpr::motion::BUILT_IN {
        assert!(text.contains(&format!("| `{name}` |")), "no row for {name}");
    }
    let folder = reader_folder("tasks", &text);
    let used = commands(&text);
    for file in ["circle.toml", "arch.toml", "too-fast.toml"] {
        assert!(folder.path().join(file).is_file(), "{file} is not shown");
        let runs = used.iter().any(|line| line.contains(file));
        assert!(runs, "no command uses {file}");
    }
    // The document quotes the message.
    let output = run("mcdpr run too-fast.toml", folder.path());
    // It is wrapped for reading.
    let message = String::from_utf8_lossy(&output.stderr).replace('│', " ");
    let message = message.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(message.contains("no less than 5.97"), "{message}");
}

#[test]
fn files_that_the_documentation_names_are_there() {
    let folders = [
        "docs/",
        "firmware/",
        "host/",
        "kinematics/",
        "protocol/",
        "robots/",
        "simulator/",
        "tests/",
        "xtask/",
    ];
    let mut seen = BTreeSet::new();
    for (name, text) in documents() {
        for word in text.lines().flat_map(quoted) {
            let is_file = [".rs", ".toml", ".md"]
                .iter()
                .any(|end| word.ends_with(end));
            let is_file = is_file && !has_placeholder(word);
            if is_file && folders.iter().any(|folder| word.starts_with(folder)) {
                assert!(root().join(word).is_file(), "{name}: {word} is not there");
                seen.insert(word.to_owned());
            }
        }
        let links = text.split("](").skip(1);
        for link in links.filter_map(|rest| rest.split(')').next()) {
            let file = link.split('#').next().unwrap_or_default();
            if !file.contains(':') && !file.is_empty() {
                let from = root().join(&name).parent().unwrap().join(file);
                assert!(from.exists(), "{name}: link to {link} leads nowhere");
            }
        }
    }
    assert!(seen.len() > 20, "{seen:?}");
}

#[test]
fn lines_are_distinguished_from_placeholders() {
    for line in [
        "mcdpr",
        "mcdpr demo --json",
        "cargo run --release",
        "cargo run --release -- ik 1 2 3",
    ] {
        assert!(
            arguments(line).is_some() && !has_placeholder(line),
            "{line}"
        );
    }
    for line in [
        "mcdpr run paper:table7 --on PORT",
        "mcdpr ik --robot FILE",
        "mcdpr run <task>",
    ] {
        assert!(has_placeholder(line), "{line}");
    }
    assert!(!has_placeholder("mcdpr run a.toml # PORT"));
    for line in ["cargo run --release-ish", "mcdprx", "cargo build --release"] {
        assert!(arguments(line).is_none(), "{line}");
    }
}

/// The folders in which a word of the fault list's fifth column has its tests.
fn folders(word: &str) -> &'static [&'static str] {
    match word {
        "core" => &["firmware/tests/core", "firmware/src/controller"],
        "protocol" => &["protocol/tests"],
        "chip" => &["tests/tests/chip_faults", "tests/tests", "emulator/tests"],
        "twin" => &["twin/tests"],
        "host" => &[
            "tests/tests",
            "host/src",
            "core/src",
            "core/src/robot/tests",
        ],
        _ => &["tests/tests"],
    }
}

/// Names of the tests in a file.
fn tests_in(path: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    let mut names = Vec::new();
    let mut lines = text.lines().map(str::trim);
    while let Some(line) = lines.next() {
        if line != "#[test]" {
            continue;
        }
        let function = lines.find_map(|line| line.strip_prefix("fn "));
        let name = function.and_then(|rest| rest.split('(').next());
        names.extend(name.map(str::to_owned));
    }
    names
}

/// Whether a name is of this form, in which `*` stands for anything.
fn matches(form: &str, name: &str) -> bool {
    match form.split_once('*') {
        None => form == name,
        Some((start, rest)) => name.strip_prefix(start).is_some_and(|left| {
            let ends = left.char_indices().map(|(at, _)| at).chain([left.len()]);
            ends.into_iter().any(|at| matches(rest, &left[at..]))
        }),
    }
}

#[test]
fn forms_with_stars_match_as_they_look() {
    assert!(matches("l1_*", "l1_l3_x") && matches("*_l3_*", "l1_l3_x") && matches("a", "a"));
    assert!(!matches("l1_*", "l10_x") && !matches("*_l3", "l1_l3_x") && !matches("a", "ab"));
}

/// Each row of the fault list has tests that carry its number, and each test that it names is
/// there; rows without a test are those that none can show.
#[test]
fn the_fault_list_names_tests_that_are_there() {
    const WITHOUT: [&str; 2] = ["F3", "F4"];
    let text = std::fs::read_to_string(root().join("docs/faults.md")).unwrap();
    let (mut rows, mut wrong) = (BTreeSet::new(), Vec::new());
    for line in text.lines() {
        let cells: Vec<_> = line
            .split(" | ")
            .map(|cell| cell.trim_matches(['|', ' ']))
            .collect();
        let [id, number, _, _, _, tested, _] = cells[..] else {
            continue;
        };
        if number.parse::<u8>().is_err() {
            continue;
        }
        rows.insert(id.to_owned());
        let token = id.to_lowercase();
        let carries = |name: &String| name.split('_').any(|part| part == token);
        let mut shown = false;
        for part in tested.split(';') {
            let word = part.split_whitespace().next().unwrap_or_default();
            for item in part.split('`').skip(1).step_by(2) {
                let Some((file, form)) = item.split_once("::") else {
                    if !root().join(item).exists() {
                        wrong.push(format!("{id}: {item} is not there"));
                    }
                    continue;
                };
                let files = folders(word).iter().map(|folder| root().join(folder));
                let files = files.map(|folder| folder.join(format!("{file}.rs")));
                let names: Vec<_> = files.flat_map(|file| tests_in(&file)).collect();
                let found: Vec<_> = names.iter().filter(|name| matches(form, name)).collect();
                let for_it = found.iter().any(|name| carries(name));
                shown |= for_it;
                if found.is_empty() || (word == "chip" && !for_it) {
                    wrong.push(format!("{id}: there is no {word} test {item}"));
                }
            }
        }
        if !shown && !WITHOUT.contains(&id) {
            wrong.push(format!("{id}: no test carries its number"));
        }
    }
    for fault in mcdpr_protocol::FaultId::ALL {
        if !rows.contains(fault.name()) {
            wrong.push(format!("{} has no row", fault.name()));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
