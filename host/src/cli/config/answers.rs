//! The answers that describe a robot of one's own: options, or questions on a terminal.

use super::super::Failed;
use std::io::{BufRead as _, IsTerminal as _, Write as _};
use std::path::Path;

/// A winch module that the program knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Module {
    /// Gear of 27:1, up to 0.62 m/s of cable, sensors for 200 N
    #[value(name = "fast-27")]
    Fast,
    /// The paper's gear of 371:1, up to 45 mm/s of cable, sensors for 39 N
    #[value(name = "geared-371")]
    Geared,
}

impl Module {
    pub(super) const fn file(self) -> &'static str {
        match self {
            Self::Fast => "modules/fast-27.toml",
            Self::Geared => "modules/geared-371.toml",
        }
    }

    /// Greatest tension of its sensor, N.
    pub(super) const fn most_n(self) -> f64 {
        match self {
            Self::Fast => 200.0,
            Self::Geared => 39.13,
        }
    }
}

/// The answers; what is absent is asked for on a terminal.
#[derive(Debug, Clone, Default, clap::Args)]
pub(crate) struct Answers {
    /// Name of the robot; without it, that of the file
    #[arg(long, value_name = "TEXT")]
    pub(super) name: Option<String>,
    /// Size of the frame: the anchors are its corners, the origin is on the floor in its middle
    #[arg(long, num_args = 3, value_names = ["X", "Y", "Z"], allow_negative_numbers = true, conflicts_with = "anchor_mm")]
    pub(super) frame_mm: Option<Vec<f64>>,
    /// Cables in a frame: 4 (from the top corners) or 8 (from all corners)
    #[arg(long, value_name = "N", conflicts_with = "anchor_mm")]
    pub(super) cables: Option<u8>,
    /// An anchor, world frame, mm; once for each cable, in order
    #[arg(long, num_args = 3, value_names = ["X", "Y", "Z"], allow_negative_numbers = true)]
    pub(super) anchor_mm: Vec<f64>,
    /// Mass of the platform with its tool, kg
    #[arg(long, value_name = "KG", allow_negative_numbers = true)]
    pub(super) mass_kg: Option<f64>,
    /// Size of the platform; cables are attached at its edges
    #[arg(long, num_args = 3, value_names = ["X", "Y", "Z"], allow_negative_numbers = true)]
    pub(super) platform_mm: Option<Vec<f64>>,
    /// Winches
    #[arg(long, value_enum)]
    pub(super) winch: Option<Module>,
    /// Greatest opening of a gripper on the platform; without it there is none
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    pub(super) gripper_mm: Option<f64>,
    /// A depth camera (D415) on the platform
    #[arg(long)]
    pub(super) camera: bool,
}

impl Answers {
    /// Whether anything was given.
    pub(super) const fn is_empty(&self) -> bool {
        self.name.is_none()
            && self.frame_mm.is_none()
            && self.cables.is_none()
            && self.anchor_mm.is_empty()
            && self.mass_kg.is_none()
            && self.platform_mm.is_none()
            && self.winch.is_none()
            && self.gripper_mm.is_none()
            && !self.camera
    }
}

/// Asks on the terminal; an empty line takes the answer in brackets. With a number of `modules` the winches are known.
pub(super) fn ask(file: &Path, modules: Option<usize>) -> Result<Answers, Failed> {
    let stem = file.file_stem().and_then(|stem| stem.to_str());
    let mut asker = Asker(Vec::new());
    let name = asker.line("Name of the robot", stem.unwrap_or("my-robot"))?;
    let frame = asker.line("Size of the frame x y z, mm", "1000 1000 1000")?;
    let usual = if modules == Some(8) { "8" } else { "4" };
    let question = "Cables: 4 from the top corners, or 8 from all corners";
    let cables = asker.line(question, usual)?;
    let mass = asker.line("Mass of the platform with its tool, kg", "1.5")?;
    let platform = asker.line("Size of the platform x y z, mm", "200 200 80")?;
    let question = "Winches: fast-27 (0.62 m/s, 200 N) or geared-371 (45 mm/s, 39 N)";
    let winch = match modules {
        None => Some(asker.line(question, "fast-27")?),
        Some(_) => None,
    };
    let gripper = asker.line("Opening of a gripper, mm; 0: none", "0")?;
    let camera = asker.line("A depth camera on the platform, y or n", "n")?;
    let bad = || Failed::from_error("the answers");
    let numbers = |text: &str| -> Result<Vec<f64>, Failed> {
        let words = text.split([' ', ',', 'x']).filter(|word| !word.is_empty());
        let numbers: Result<Vec<f64>, _> = words.map(str::parse).collect();
        numbers.map_err(|_| bad()(format!("{text:?} is not a list of numbers")))
    };
    Ok(Answers {
        name: Some(name),
        frame_mm: Some(numbers(&frame)?),
        cables: Some(
            cables
                .parse()
                .map_err(|_| bad()(format!("{cables:?} is not a number of cables")))?,
        ),
        anchor_mm: Vec::new(),
        mass_kg: Some(
            mass.parse()
                .map_err(|_| bad()(format!("{mass:?} is not a mass in kg")))?,
        ),
        platform_mm: Some(numbers(&platform)?),
        winch: winch
            .map(|winch| <Module as clap::ValueEnum>::from_str(&winch, true).map_err(bad()))
            .transpose()?,
        gripper_mm: match gripper.parse() {
            Ok(0.0) => None,
            Ok(opening) => Some(opening),
            Err(_) => return Err(bad()(format!("{gripper:?} is not an opening in mm"))),
        },
        camera: match camera.as_str() {
            "y" | "yes" => true,
            "n" | "no" => false,
            other => return Err(bad()(format!("{other:?} is neither y nor n"))),
        },
    })
}

/// Questions on standard error, answers on standard input.
struct Asker(Vec<u8>);

impl Asker {
    fn line(&mut self, question: &str, default: &str) -> Result<String, Failed> {
        let failed = || Failed::from_error("asking");
        eprint!("{question} [{default}]: ");
        std::io::stderr().flush().map_err(failed())?;
        self.0.clear();
        let read = std::io::stdin().lock().read_until(b'\n', &mut self.0);
        if read.map_err(failed())? == 0 {
            return Err(Failed::from_error("asking")("the input ended"));
        }
        let text = String::from_utf8_lossy(&self.0).trim().to_owned();
        Ok(if text.is_empty() {
            default.to_owned()
        } else {
            text
        })
    }
}

/// Whether questions can be asked.
pub(super) fn can_ask() -> bool {
    std::io::stdin().is_terminal()
}
