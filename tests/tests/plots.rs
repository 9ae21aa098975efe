//! Plots as files: the ending of a named one decides its kind, and a foreign reader finds the words of a PDF.

use mcdpr_tests::mcdpr;
use mcdpr_tests::process::Folder;
use std::path::Path;
use std::process::Output;

fn plan(at: &Path, words: &[&str]) -> Output {
    let mut command = mcdpr();
    command.args(["plan", "paper:table8", "--json"]).args(words);
    command.current_dir(at).output().unwrap()
}

fn done(output: &Output) {
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
}

#[test]
fn the_ending_of_a_plots_name_decides_and_another_one_is_refused_before_any_work() {
    let folder = Folder::new("plots-ending");
    let at = folder.path();
    let refused = plan(at, &["--plot", "plan.jpg"]);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(1), "{said}");
    assert!(
        said.contains("plan.jpg") && said.contains(".svg, .png or .pdf"),
        "{said}"
    );
    assert_eq!(
        std::fs::read_dir(at).unwrap().count(),
        0,
        "nothing was written"
    );
    let said = mcdpr()
        .args(["calibrate", "target", "--out", "target.jpg"])
        .current_dir(at)
        .output()
        .unwrap();
    assert_eq!(said.status.code(), Some(1));
    assert_eq!(std::fs::read_dir(at).unwrap().count(), 0);
    for (name, begin) in [
        ("a.svg", "<svg"),
        ("a.PNG", "\u{fffd}PNG"),
        ("a.pdf", "%PDF-"),
    ] {
        done(&plan(at, &["--plot", name, "--dry-run"]));
        let bytes = std::fs::read(at.join(name)).unwrap();
        assert!(String::from_utf8_lossy(&bytes).starts_with(begin), "{name}");
    }
}

/// What prints it is another program: width and height of each page decide the scale.
#[test]
fn a_target_as_pdf_has_its_sheets_as_pages_of_their_true_size() {
    let folder = Folder::new("plots-target");
    let at = folder.path();
    for (paper, pages, size_mm) in [("a4", 6, [210.0, 297.0]), ("a3", 2, [297.0, 420.0])] {
        let out = mcdpr()
            .args([
                "calibrate",
                "target",
                "--paper",
                paper,
                "--out",
                "target.pdf",
            ])
            .current_dir(at)
            .output()
            .unwrap();
        done(&out);
        let bytes = std::fs::read(at.join("target.pdf")).unwrap();
        let text = String::from_utf8_lossy(&bytes);
        let boxes: Vec<Vec<f64>> = text
            .split("/MediaBox [")
            .skip(1)
            .map(|rest| {
                let corners = rest.split(']').next().unwrap().split_whitespace();
                corners.map(|number| number.parse().unwrap()).collect()
            })
            .collect();
        assert_eq!(boxes.len(), pages, "{paper}");
        for corners in boxes {
            let mut page_mm = [corners[2], corners[3]].map(|points| points / 72.0 * 25.4);
            page_mm.sort_by(f64::total_cmp);
            for (is, wanted) in page_mm.into_iter().zip(size_mm) {
                assert!((is - wanted).abs() < 0.01, "{paper}: {is} mm");
            }
        }
    }
    assert_eq!(
        std::fs::read_dir(at).unwrap().count(),
        1,
        "one file for all sheets"
    );
}

#[test]
fn plots_without_a_name_are_of_the_chosen_kind() {
    let folder = Folder::new("plots-kind");
    let at = folder.path();
    done(&plan(at, &["--plots", "png", "--record", "first"]));
    let file = std::fs::File::open(at.join("first/plan.png")).unwrap();
    let mut reader = png::Decoder::new(std::io::BufReader::new(file))
        .read_info()
        .unwrap();
    let mut colors = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut colors).unwrap();
    // Two columns of 85 mm and the gap between them, at 300 dpi.
    assert_eq!(info.width, 2033);
    let dark = colors.chunks(3).filter(|pixel| pixel[0] < 0x60).count();
    assert!(dark > 5000, "{dark} dark pixels");
    let run = mcdpr()
        .args([
            "run",
            "paper:table8",
            "--record",
            "runs/line",
            "--plots",
            "pdf",
        ])
        .current_dir(at)
        .output()
        .unwrap();
    done(&run);
    assert!(at.join("runs/line/path.pdf").is_file() && !at.join("runs/line/path.svg").exists());
    let report = mcdpr()
        .args(["report", "runs/line", "--plots", "pdf", "--json"])
        .current_dir(at)
        .output()
        .unwrap();
    done(&report);
    let said: serde_json::Value = serde_json::from_slice(&report.stdout).unwrap();
    let plots = said["plots"].as_array().unwrap();
    assert!(plots.len() >= 8, "{said}");
    assert!(
        plots
            .iter()
            .all(|plot| at.join(plot.as_str().unwrap()).is_file())
    );
}

const READER: &str = "\
import sys, pypdf
page = pypdf.PdfReader(sys.argv[1], strict=True).pages[0]
print(float(page.mediabox.width) / 72 * 25.4)
print(page.extract_text())
";

#[test]
fn a_foreign_reader_finds_size_and_words_of_a_pdf() {
    let folder = Folder::new("plots-pdf");
    let at = folder.path();
    done(&plan(at, &["--plot", "plan.pdf", "--dry-run"]));
    // target/PROFILE/deps/TEST
    let target = std::env::current_exe().unwrap();
    let python = target.ancestors().nth(3).unwrap().join("python/bin/python");
    let read = std::process::Command::new(&python)
        .args(["-c", READER, "plan.pdf"])
        .current_dir(at)
        .output()
        .unwrap_or_else(|error| {
            panic!(
                "{}: {error}; `cargo xtask test` installs it",
                python.display()
            )
        });
    done(&read);
    let said = String::from_utf8_lossy(&read.stdout);
    let width_mm: f64 = said.lines().next().unwrap().parse().unwrap();
    assert!((width_mm - 172.1).abs() < 0.2, "{width_mm} mm");
    for words in [
        "Path of the tool from above",
        "Tensions",
        "cable 4",
        "time, s",
        "degrees",
    ] {
        assert!(said.contains(words), "{words} is not in\n{said}");
    }
}
