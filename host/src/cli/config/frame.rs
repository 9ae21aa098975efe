//! A robot of one's own as a description, and as the text of its file.

use super::answers::{Answers, Module};
use std::fmt::Write as _;
use std::path::Path;

/// Cable beyond the greatest distance in the frame, turns of a drum.
const SPARE_TURNS: f64 = 2.0;
/// Share of the frame, from its middle to each side, in which the tool may be: of a hanging platform,
/// and of one that is held from below, too. A hanging one tilts and loses tension near the sides.
const BOX_SHARES: [f64; 2] = [0.2, 0.3];
/// Heights of that box about home, share of the frame's height.
const BOX_HEIGHTS: [f64; 2] = [-0.25, 0.12];
/// Angle of a hanging platform's cables below the horizontal at home: flatter ones hold it stiffer, and
/// steeper ones with less tension.
const HOME_DEG: f64 = 30.0;
/// Height of the platform's origin over the tool, mm: the default of `tcp_mm`.
const TOOL_MM: f64 = 80.0;
/// Stiffness EA of a cable, N: an assumption for a braided line of 1 mm, softer than the robot file's
/// default. The file says that it is to be measured.
const EA_N: f64 = 20_000.0;
/// Radius of the modules' drums, mm.
const DRUM_MM: f64 = 20.0;
/// Cables whose drives one bus commands every 2 ms.
const FEW: usize = 4;
/// More drives need a longer period (docs/protocol.md, load of the bus).
const MANY_DRIVES: &str =
    "\n[bus]\nperiod_us = 4000                  # more drives than one bus commands in 2 ms\n";
/// Gains of eight-cable: six held lengths let the platform give way to none.
pub(super) const STIFF_GAINS: &str = "kp = 0.1                          # gains of eight-cable; tune with `mcdpr tune tension`\n\
    kd = 0\nki = 2\ndamping_ns_per_m = 20\nfilter_hz = 80\n";
/// Gains of a robot whose winches have gears with friction, play and losses, hanging or held from below: the drive's own
/// loop overcomes them. Those of paper-table5 and eight-cable.
pub(super) const GEARED_GAINS: &str = "output = \"velocity\"                # the drive's own loop overcomes friction and loss of the gears\n\
    kp = 4.0                           # mm/s per N; tune with `mcdpr tune tension`\n\
    kd = 0.0133                        # mm/s per N/s\nki = 0\nfilter_hz = 150\n";
/// Depth of the calibration target below home, mm: a camera on the platform sees a whole board of 0.3 m, as
/// long as the target is not below the floor.
const TARGET_BELOW_MM: f64 = 650.0;
/// Height of the tool's box with a gripper and a camera, mm: between a grasp on a tray's floor and the place from
/// which the camera sees the whole tray (docs/picking.md).
const PICKING_MM: f64 = 345.0;
/// Least set-point, N: twice the least tension that a plan may ask by default.
const LEAST_SETPOINT_N: f64 = 2.0;
/// Gravity, m/s².
const G: f64 = mcdpr_kinematics::GRAVITY_MPS2;

/// A complete description.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Frame {
    name: String,
    /// Anchors and attachments, mm.
    pub(super) cables: Vec<Ends>,
    /// Whether cables come from below, too.
    pub(super) from_below: bool,
    /// Greatest corner minus least corner of the anchors, the floor included, mm.
    size_mm: [f64; 3],
    /// Middle of the anchors in x and y, mm.
    middle_mm: [f64; 2],
    mass_kg: f64,
    platform_mm: [f64; 3],
    pub(super) winches: Winches,
    /// Greatest tension of the weakest sensor, N.
    pub(super) most_n: f64,
    gripper_mm: Option<f64>,
    camera: bool,
}

/// The winches of a robot.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Winches {
    /// All of one kind.
    Alike(Module),
    /// Each with its own file, in the order of the cables.
    Own(Vec<OwnWinch>),
}

/// A winch with a module file of its own.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct OwnWinch {
    /// The file, relative to the robot file.
    pub(super) file: String,
    /// Number of the winch, and whether its file has it.
    pub(super) id: (u8, bool),
    /// Number of its drive, and whether its file has it.
    pub(super) node: (u8, bool),
}

/// Ends of a cable, mm: world, and platform.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ends {
    anchor: [f64; 3],
    attachment: [f64; 3],
    /// Direction of the cable along the pulley's swivel axis.
    swivel_z: f64,
}

fn positive(what: &str, values: &[f64]) -> Result<(), String> {
    if values.iter().all(|v| v.is_finite() && *v > 0.0) {
        return Ok(());
    }
    Err(format!("{what} must be over 0"))
}

fn three(what: &str, values: &[f64]) -> Result<[f64; 3], String> {
    let found: Result<[f64; 3], _> = values.try_into();
    found.map_err(|_| format!("{what} needs three numbers, mm"))
}

/// Checks the answers and adds the defaults.
pub(super) fn complete(file: &Path, answers: &Answers) -> Result<Frame, String> {
    let stem = file.file_stem().and_then(|stem| stem.to_str());
    let name = answers.name.clone().or_else(|| stem.map(str::to_owned));
    let name = name.unwrap_or_else(|| "my-robot".to_owned());
    if name.trim().is_empty() || name.chars().any(|c| c.is_control() || "\"\\".contains(c)) {
        return Err("a name is a text without quotes and line ends".to_owned());
    }
    let mass_kg = answers.mass_kg.unwrap_or(1.5);
    positive("the mass", &[mass_kg])?;
    let platform_mm = match &answers.platform_mm {
        Some(size) => three("--platform-mm", size)?,
        None => [200.0, 200.0, 80.0],
    };
    positive("the platform's size", &platform_mm)?;
    let module = answers.winch.unwrap_or(Module::Fast);
    if let Some(opening) = answers.gripper_mm {
        positive("the gripper's opening", &[opening])?;
    }
    let (cables, from_below) = if let Some(frame) = &answers.frame_mm {
        let frame = three("--frame-mm", frame)?;
        positive("the frame's size", &frame)?;
        if (0..3).any(|i| frame[i] <= platform_mm[i]) {
            return Err(format!(
                "a platform of {} mm does not fit into a frame of {} mm: sizes are in mm, not in m",
                list(&platform_mm),
                list(&frame)
            ));
        }
        match answers.cables.unwrap_or(4) {
            4 => (top_corners(frame, platform_mm, 0.0), false),
            8 => (all_corners(frame, platform_mm), true),
            other => {
                return Err(format!(
                    "a frame has 4 or 8 cables, not {other}; give any other number by --anchor-mm"
                ));
            }
        }
    } else if answers.anchor_mm.is_empty() {
        return Err(
            "give the frame's size with --frame-mm X Y Z, or every anchor with --anchor-mm"
                .to_owned(),
        );
    } else {
        let anchors: Vec<[f64; 3]> = answers
            .anchor_mm
            .chunks_exact(3)
            .map(|c| [c[0], c[1], c[2]])
            .collect();
        (around(&anchors, platform_mm), false)
    };
    let ends = |axis: usize| {
        let values = cables.iter().map(|cable| cable.anchor[axis]);
        values.fold((f64::MAX, f64::MIN), |(low, high), v| {
            (low.min(v), high.max(v))
        })
    };
    let (x, y, z) = (ends(0), ends(1), ends(2));
    Ok(Frame {
        name,
        from_below,
        size_mm: [x.1 - x.0, y.1 - y.0, z.1 - z.0.min(0.0)],
        middle_mm: [(x.0 + x.1) / 2.0, (y.0 + y.1) / 2.0],
        cables,
        mass_kg,
        platform_mm,
        winches: Winches::Alike(module),
        most_n: module.most_n(),
        gripper_mm: answers.gripper_mm,
        camera: answers.camera,
    })
}

/// Corners in the order of the built-in robots: anticlockwise from -x, -y seen from below.
const CORNERS: [[f64; 2]; 4] = [[-0.5, -0.5], [-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]];

fn top_corners(frame: [f64; 3], platform: [f64; 3], z: f64) -> Vec<Ends> {
    CORNERS
        .map(|[x, y]| Ends {
            anchor: [x * frame[0], y * frame[1], frame[2]],
            attachment: [x * platform[0], y * platform[1], z],
            swivel_z: 1.0,
        })
        .to_vec()
}

/// Four cables from above to the platform's underside, on a rectangle that is long in x, and four from
/// below to its top, on one that is long in y: so tilt and yaw are held (as in `eight-cable`).
fn all_corners(frame: [f64; 3], platform: [f64; 3]) -> Vec<Ends> {
    let [a, b, c] = platform;
    let mut cables = top_corners(frame, [a, b / 2.0, c], -c / 2.0);
    cables.extend(CORNERS.map(|[x, y]| Ends {
        anchor: [x * frame[0], y * frame[1], 0.0],
        attachment: [x * a / 2.0, y * b, c / 2.0],
        swivel_z: -1.0,
    }));
    cables
}

/// Attachments towards the anchors on the ellipse in the platform's outline.
fn around(anchors: &[[f64; 3]], platform: [f64; 3]) -> Vec<Ends> {
    let count = anchors.len().max(1) as f64;
    let middle = |axis: usize| anchors.iter().map(|a| a[axis]).sum::<f64>() / count;
    let (x, y) = (middle(0), middle(1));
    let ends = anchors.iter().map(|anchor| {
        let angle = (anchor[1] - y).atan2(anchor[0] - x);
        let rounded = |v: f64| (v * 10.0).round() / 10.0;
        Ends {
            anchor: *anchor,
            attachment: [
                rounded(angle.cos() * platform[0] / 2.0),
                rounded(angle.sin() * platform[1] / 2.0),
                0.0,
            ],
            swivel_z: 1.0,
        }
    });
    ends.collect()
}

impl OwnWinch {
    /// Adds its table: what its file has is not repeated.
    fn add_to(&self, text: &mut String) {
        // Writing to a string cannot fail.
        let _ = write!(text, "\n[[winch]]\nmodule = \"{}\"\n", self.file);
        for (key, (number, in_file)) in [("id", self.id), ("node", self.node)] {
            if !in_file {
                let _ = writeln!(text, "{key} = {number}");
            }
        }
    }
}

/// Numbers as a person writes them.
fn list(values: &[f64]) -> String {
    let words: Vec<_> = values.iter().map(|v| format!("{}", v + 0.0)).collect();
    format!("[{}]", words.join(", "))
}

impl Frame {
    /// The tool's place at home.
    fn home_mm(&self) -> [f64; 3] {
        let [x, y] = self.middle_mm;
        if self.from_below {
            return [x, y, (self.size_mm[2] * 0.5).round()];
        }
        let count = self.cables.len().max(1) as f64;
        let mean = |of: &dyn Fn(&Ends) -> f64| self.cables.iter().map(of).sum::<f64>() / count;
        let reach = |cable: &Ends| {
            let across = [0, 1].map(|i| cable.anchor[i] - self.middle_mm[i] - cable.attachment[i]);
            across[0].hypot(across[1])
        };
        let drop = mean(&reach) * HOME_DEG.to_radians().tan();
        [
            x,
            y,
            (mean(&|cable| cable.anchor[2]) - drop - TOOL_MM).round(),
        ]
    }

    /// Tension with which all cables carry alike at home, N; more than the weight's share where
    /// cables pull from below.
    fn setpoint_n(&self) -> f64 {
        let home = self.home_mm();
        let rise: f64 = self
            .cables
            .iter()
            .map(|cable| {
                let origin = [home[0], home[1], home[2] + TOOL_MM];
                let d: [f64; 3] =
                    std::array::from_fn(|i| cable.anchor[i] - origin[i] - cable.attachment[i]);
                d[2].max(0.0) / d.iter().map(|v| v * v).sum::<f64>().sqrt().max(1.0)
            })
            .sum();
        let even_n = self.mass_kg * G / rise.max(0.1);
        let wanted = if self.from_below {
            2.0 * even_n
        } else {
            even_n
        };
        wanted.min(0.5 * self.most_n).max(LEAST_SETPOINT_N)
    }

    /// The file: what differs from the defaults.
    /// `gains`: lines of the table `[tension]`.
    pub(super) fn text(&self, gains: &str) -> String {
        let diagonal_mm = self.size_mm.iter().map(|v| v * v).sum::<f64>().sqrt();
        let turns = (diagonal_mm / (std::f64::consts::TAU * DRUM_MM)).ceil() + SPARE_TURNS;
        let [a, b, c] = self.platform_mm.map(|mm| mm * 1e-3);
        let inertia = [b * b + c * c, a * a + c * c, a * a + b * b]
            .map(|squares| (self.mass_kg / 12.0 * squares * 1e5).round() / 1e5);
        let low_mm = if self.from_below { 0.0 } else { -30.0 };
        let [x, y] = self.middle_mm;
        let [half_x, half_y] = [self.size_mm[0], self.size_mm[1]]
            .map(|size| size * BOX_SHARES[usize::from(self.from_below)]);
        let home = self.home_mm();
        let [mut bottom, top] =
            BOX_HEIGHTS.map(|share| home[2] + (self.size_mm[2] * share).round());
        if self.gripper_mm.is_some() && self.camera {
            // Not below the floor: a frame that is too low for picking cannot pick.
            bottom = bottom.min((top - PICKING_MM).max(0.0));
        }
        let mut text = format!(
            "# {}: written by `mcdpr config {}`. Every key is explained in docs/robot-file.md; absent\n\
             # keys have their defaults. Lines marked \"assumption\" are yours to measure.\n\n\
             name = \"{}\"\n\n[platform]\nmass_kg = {}                     # with tool, gripper and wiring\n\
             center_of_mass_mm = [0, 0, {low_mm}]      # assumption\n\
             inertia_kg_m2 = {}  # assumption: a solid box of {} mm\n",
            self.name,
            match self.winches {
                Winches::Alike(_) => "init",
                Winches::Own(_) => "compose",
            },
            self.name,
            self.mass_kg,
            list(&inertia),
            list(&self.platform_mm),
        );
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "\n[all_cables]\ncontrol = \"auto\"                 # the program chooses which are held by length\n\
             routing_length_mm = {:.0}          # assumption: from the drum up the post\n\
             pulley_radius_mm = 15             # assumption\n\
             ea_n = {EA_N}                     # assumption: a braided line of 1 mm\n",
            self.size_mm[2],
        );
        match &self.winches {
            Winches::Alike(module) => {
                let _ = write!(
                    text,
                    "\n[all_winches]\nmodule = \"{}\"\nturns_max = {turns:.0}                    # enough for the frame's diagonal\n",
                    module.file(),
                );
            }
            Winches::Own(winches) => winches.iter().for_each(|winch| winch.add_to(&mut text)),
        }
        for (index, cable) in self.cables.iter().enumerate() {
            let _ = write!(
                text,
                "\n[[cable]]\nanchor_mm = {}\nattachment_mm = {}\n",
                list(&cable.anchor),
                list(&cable.attachment)
            );
            if cable.swivel_z < 0.0 {
                text.push_str("swivel_axis = [0, 0, -1]\n");
            }
            if let Winches::Own(winches) = &self.winches
                && let Some(winch) = winches.get(index)
            {
                let _ = writeln!(text, "winch = {}", winch.id.0);
            }
        }
        if self.cables.len() > FEW {
            text.push_str(MANY_DRIVES);
        }
        let _ = write!(
            text,
            "\n[tension]\nsetpoint_n = {:.1}\n{}\n[tool]\nhome_mm = {}\n\n[limits]\nbox_mm = [{}, {}]\n",
            self.setpoint_n(),
            gains,
            list(&home),
            list(&[x - half_x, y - half_y, bottom].map(f64::round)),
            list(&[x + half_x, y + half_y, top].map(f64::round)),
        );
        if let Some(opening) = self.gripper_mm {
            let _ = write!(
                text,
                "\n[gripper]\nkind = \"digital\"\nstroke_mm = {opening}\n\
                 switch = true                    # assumption: it reports that the jaws closed on nothing\n"
            );
        }
        if self.camera {
            let below = (home[2] - TARGET_BELOW_MM).max(0.0);
            let _ = write!(
                text,
                "\n[camera]                         # assumption: a D415 beside the tool, with the default lens\n\
                 depth = true\n\n[surroundings]\n\
                 target_mm = {}              # of the simulated calibration target\n",
                list(&[x, y, below].map(f64::round)),
            );
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answers(frame: [f64; 3], cables: u8) -> Answers {
        Answers {
            frame_mm: Some(frame.to_vec()),
            cables: Some(cables),
            ..Answers::default()
        }
    }

    #[test]
    fn a_frame_of_four_and_of_eight_cables_is_complete() {
        let four = complete(
            Path::new("a/hall.toml"),
            &answers([2000.0, 3000.0, 2500.0], 4),
        )
        .unwrap();
        assert_eq!((four.name.as_str(), four.cables.len()), ("hall", 4));
        assert_eq!(four.cables[0].anchor, [-1000.0, -1500.0, 2500.0]);
        // Four cables at these angles carry the weight alike at the set-point.
        let set = four.setpoint_n();
        assert!(set > 4.0 && set < 12.0, "{set}");
        let eight = complete(Path::new("b.toml"), &answers([2000.0, 2000.0, 1500.0], 8)).unwrap();
        assert_eq!(eight.cables.len(), 8);
        assert!(eight.text(STIFF_GAINS).contains("swivel_axis = [0, 0, -1]"));
        assert!(eight.setpoint_n() > four.setpoint_n());
    }

    #[test]
    fn bad_answers_are_refused_in_words() {
        let refused = |answers: &Answers| complete(Path::new("a.toml"), answers).unwrap_err();
        let frame = [1000.0; 3];
        assert!(refused(&Answers::default()).contains("--frame-mm"));
        assert!(refused(&answers(frame, 5)).contains("4 or 8"));
        assert!(refused(&answers([1000.0, -1.0, 1000.0], 4)).contains("over 0"));
        let named = Answers {
            name: Some("a\"b".into()),
            ..answers(frame, 4)
        };
        assert!(refused(&named).contains("without quotes"));
        let heavy = Answers {
            mass_kg: Some(f64::NAN),
            ..answers(frame, 4)
        };
        assert!(refused(&heavy).contains("mass"));
    }
}
