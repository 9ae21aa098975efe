//! `mcdpr workspace`: the robot's workspace.

use super::super::progress::Phase;
use super::super::table::lay_out;
use super::super::{Common, Failed, Outcome, write_out};
use super::grid::{self, Axis, Counts};
use super::{UNITS, conclude, quantity, slice, triple};
use crate::compute::{ComputeError, Hanging, Planned, Subject};
use crate::report::RunFolder;
use crate::units::Quantity;
use mcdpr_kinematics::{AnyWorkspaceTest, Balance, CableVec, PlatformBox, rotation_from_rpy};
use nalgebra::Vector3;
use serde::Serialize;
use std::path::PathBuf;

/// The robot's workspace: feasible positions on a grid over its box, and what limits them
#[derive(Debug, clap::Args)]
#[command(after_help = UNITS)]
pub(in super::super) struct Cmd {
    /// Distance between grid points
    #[arg(
        long,
        default_value = "20mm",
        value_name = "LENGTH",
        allow_hyphen_values = true
    )]
    step: String,
    /// Criterion of a feasible position; equilibrium for three length-held cables, else wrench
    #[arg(long, value_enum, value_name = "TEST")]
    test: Option<Test>,
    /// This cable is held at this tension; without any: those of the robot file at the tension that a plan
    /// chooses at each place
    #[arg(long = "tension", value_name = "CABLE=FORCE")]
    tensions: Vec<String>,
    /// The robot file's tension-held cables are at its set-point everywhere
    #[arg(long, conflicts_with = "tensions")]
    setpoint: bool,
    /// The attitude for wrench and forces; level if left out
    #[arg(long, num_args = 3, value_names = ["RX", "RY", "RZ"], allow_hyphen_values = true)]
    attitude: Option<Vec<String>>,
    /// Positions are those of the platform's origin, not of the tool
    #[arg(long)]
    origin: bool,
    /// Draw a slice and write it as a table (CSV); may be repeated
    #[arg(long = "slice", value_name = "AXIS=PLACE")]
    slices: Vec<String>,
    /// Folder for the slices' files, instead of runs/DATE-TIME-workspace
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Positions where two cables, or a cable and the platform, come nearer than this do not count
    #[arg(long, value_name = "LENGTH", allow_hyphen_values = true)]
    clearance: Option<String>,
    /// Edges of the platform's body, a box about its centre of mass, for --clearance
    #[arg(long, num_args = 3, value_names = ["DX", "DY", "DZ"], allow_hyphen_values = true, requires = "clearance")]
    body: Option<Vec<String>>,
}

/// Criterion of a feasible position.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Test {
    /// The platform hangs there stably, tensions and tilt within their limits
    Equilibrium,
    /// Tensions within their limits balance force and moment of gravity
    Wrench,
    /// Tensions within their limits balance the force of gravity (the paper's level platform)
    Forces,
}

/// All inputs of the test, SI.
pub(super) struct Question {
    pub(super) test: Test,
    pub(super) tensions_n: CableVec<Option<f64>>,
    /// Chooses the tensions at each place, in place of `tensions_n`.
    pub(super) planned: Option<Planned>,
    min_n: CableVec<f64>,
    max_n: CableVec<f64>,
    tilt_max_rad: f64,
    attitude_rad: [f64; 3],
    /// The point whose positions are tested, platform frame, m.
    pub(super) point_m: Vector3<f64>,
    pub(super) clearance_m: Option<f64>,
    pub(super) body: Option<PlatformBox>,
}

impl Question {
    pub(super) fn test(&self) -> AnyWorkspaceTest<'_> {
        let (min_n, max_n) = (&self.min_n[..], &self.max_n[..]);
        let fixed = |balance| AnyWorkspaceTest::Fixed {
            balance,
            rotation: self.rotation(),
            min_n,
            max_n,
        };
        match self.test {
            Test::Wrench => fixed(Balance::Wrench),
            Test::Forces => fixed(Balance::Forces),
            Test::Equilibrium => AnyWorkspaceTest::Equilibrium {
                tool_in_platform_m: self.point_m,
                tensions_n: &self.tensions_n,
                min_n,
                max_n,
                tilt_max_rad: self.tilt_max_rad,
            },
        }
    }

    /// The limits of a place.
    pub(super) fn limits(&self) -> Hanging<'_> {
        Hanging {
            tool_in_platform_m: self.point_m,
            min_n: &self.min_n,
            max_n: &self.max_n,
            tilt_max_rad: self.tilt_max_rad,
        }
    }

    pub(super) fn rotation(&self) -> nalgebra::Rotation3<f64> {
        rotation_from_rpy(self.attitude_rad)
    }
}

/// One slice of the result.
#[derive(Debug, Serialize)]
struct SliceAnswer {
    axis: Axis,
    place_m: f64,
    points: usize,
    feasible: usize,
    area_m2: f64,
    plot: String,
    csv: String,
}

/// The result, SI.
#[derive(Debug, Serialize)]
struct Answer {
    test: Test,
    places_of: &'static str,
    box_m: [[f64; 3]; 2],
    step_m: f64,
    grid: [usize; 3],
    points: usize,
    feasible: usize,
    feasible_fraction: f64,
    volume_m3: f64,
    #[serde(flatten)]
    counts: Counts,
    slices: Vec<SliceAnswer>,
}

impl Cmd {
    pub(in super::super) fn run(&self, common: &Common) -> Outcome {
        let answer = self.answer(common);
        conclude(common, answer, |answer| show(answer, &common.robot))
    }

    fn answer(&self, common: &Common) -> miette::Result<Answer> {
        let subject = super::find(common)?;
        let question = self.question(&subject)?;
        let step_m = quantity("--step", Quantity::Length, &self.step)?;
        let places = self.slices.iter().map(|text| Axis::parse(text));
        let places: Vec<_> = places.collect::<Result<_, _>>()?;
        let bounds = subject.robot.search_box_in_world_m();
        let grid = grid::over(bounds, step_m)?;
        let phase = Phase::begin("judging the places of the grid");
        let cells = grid::assess(&subject, &question, &grid)?;
        drop(phase);
        let counts = Counts::of(&cells, subject.count());
        let feasible = counts.feasible();
        let extent = grid.max_m - grid.min_m;
        let fraction = share(feasible, cells.len());
        let mut answer = Answer {
            test: question.test,
            places_of: if self.origin { "origin" } else { "tool" },
            box_m: [grid.min_m.into(), grid.max_m.into()],
            step_m,
            grid: grid.counts,
            points: cells.len(),
            feasible,
            feasible_fraction: fraction,
            volume_m3: fraction * extent.product(),
            counts,
            slices: Vec::new(),
        };
        if !places.is_empty() {
            self.slices(common, &subject, &question, &places, step_m, &mut answer)?;
        }
        Ok(answer)
    }

    fn question(&self, subject: &Subject) -> Result<Question, ComputeError> {
        let tensions_n = super::tensions_or_own(subject, &self.tensions)?;
        let by_length = tensions_n.iter().filter(|t| t.is_none()).count();
        let test = self.test.unwrap_or(match by_length {
            3 => Test::Equilibrium,
            _ => Test::Wrench,
        });
        // Cables in one plane balance no force across it: every position would be refused, or none.
        if subject.planar {
            return Err(subject.refused(mcdpr_kinematics::Error::TooFewCables {
                solver: mcdpr_kinematics::Solver::TensionDistribution,
                needed: 6,
                got: subject.count(),
            }));
        }
        if test == Test::Equilibrium && by_length != 3 {
            return Err(subject.length_held(by_length));
        }
        if test == Test::Equilibrium && self.attitude.is_some() {
            return Err(ComputeError::AttitudeFollows);
        }
        let attitude = self.attitude.as_deref();
        let attitude = attitude.map(|texts| triple("--attitude", Quantity::Angle, texts));
        let not_negative = |what, value: f64| {
            if value < 0.0 {
                let value_mm = value * 1e3;
                Err(ComputeError::Negative { what, value_mm })
            } else {
                Ok(value)
            }
        };
        let clearance = self.clearance.as_deref().map(|text| {
            let length = quantity("--clearance", Quantity::Length, text)?;
            not_negative("--clearance", length)
        });
        let body = self.body.as_deref().map(|texts| {
            let edges = triple("--body", Quantity::Length, texts)?;
            for edge in edges {
                not_negative("--body", edge)?;
            }
            Ok::<_, ComputeError>(PlatformBox {
                center_m: subject.robot.platform.center_of_mass_m,
                half_size_m: Vector3::from(edges) / 2.0,
            })
        });
        let limits = &subject.robot.limits;
        // A test that does not take given tensions gets them as limits.
        let pinned = test != Test::Equilibrium && !self.tensions.is_empty();
        let bound = |limit: f64| {
            CableVec::from_fn(subject.count(), |i| {
                let given = tensions_n.get(i).copied().flatten();
                given.filter(|_| pinned).unwrap_or(limit)
            })
        };
        let chosen = test == Test::Equilibrium && self.tensions.is_empty() && !self.setpoint;
        Ok(Question {
            test,
            planned: chosen.then(|| subject.planned(!self.origin)).flatten(),
            min_n: bound(limits.tension_min_n),
            max_n: bound(limits.tension_max_n),
            tensions_n,
            tilt_max_rad: limits.tilt_max_rad,
            attitude_rad: attitude.transpose()?.unwrap_or([0.0; 3]),
            point_m: subject.point(!self.origin),
            clearance_m: clearance.transpose()?,
            body: body.transpose()?,
        })
    }

    fn slices(
        &self,
        common: &Common,
        subject: &Subject,
        question: &Question,
        places: &[(Axis, f64)],
        step_m: f64,
        answer: &mut Answer,
    ) -> miette::Result<()> {
        let failed = || Failed::from_error("writing the slices");
        let given = self.out.as_deref().or(common.record.as_deref());
        let folder = RunFolder::create(given, "workspace").map_err(failed())?;
        let whole = grid::over(subject.robot.search_box_in_world_m(), step_m)?;
        for &(axis, place_m) in places {
            let grid = axis.cut(&whole, place_m);
            let cells = grid::assess(subject, question, &grid)?;
            let feasible = cells.iter().filter(|cell| cell.is_feasible()).count();
            let across = axis.others().map(|k| grid.max_m[k] - grid.min_m[k]);
            let stem = format!("slice-{}-{:.1}mm", axis.name(), place_m * 1e3);
            let csv = format!("{stem}.csv");
            let title = format!(
                "{}: {} = {:.1} mm, {} of the {}",
                subject.robot.name,
                axis.name(),
                place_m * 1e3,
                test_in_words(question.test),
                answer.places_of
            );
            let picture = slice::draw(&title, axis, &grid, &cells);
            let plot = folder.plot(&stem, &picture, common.plots());
            let plot = plot.map_err(failed())?;
            folder
                .write(&csv, &grid::table(&grid, &cells))
                .map_err(failed())?;
            let path = |name: &str| folder.path().join(name).display().to_string();
            answer.slices.push(SliceAnswer {
                axis,
                place_m,
                points: cells.len(),
                feasible,
                area_m2: share(feasible, cells.len()) * across.iter().product::<f64>(),
                plot: path(&plot),
                csv: path(&csv),
            });
        }
        folder
            .write_json("workspace.json", answer)
            .map_err(failed())?;
        Ok(())
    }
}

fn test_in_words(test: Test) -> &'static str {
    match test {
        Test::Equilibrium => "equilibria",
        Test::Wrench => "wrench-feasible places",
        Test::Forces => "force-feasible places",
    }
}

#[expect(clippy::cast_precision_loss, reason = "far below 2^52")]
fn share(part: usize, of: usize) -> f64 {
    part as f64 / of.max(1) as f64
}

fn show(answer: &Answer, robot: &str) {
    let [low, high] = answer.box_m;
    let [nx, ny, nz] = answer.grid;
    say!(
        "{robot}: {} of the {}",
        test_in_words(answer.test),
        answer.places_of
    );
    let span = |k: usize| {
        let mm = |corner: &[f64; 3]| corner.get(k).map_or(0.0, |x| x * 1e3);
        format!("{:.0} to {:.0}", mm(&low), mm(&high))
    };
    say!(
        "grid     {nx} x {ny} x {nz} = {} points, {:.1} mm apart, x {} y {} z {} mm",
        answer.points,
        answer.step_m * 1e3,
        span(0),
        span(1),
        span(2)
    );
    say!(
        "feasible {} points, {:.1} %, {:.4} m3",
        answer.feasible,
        answer.feasible_fraction * 1e2,
        answer.volume_m3
    );
    write_out(&lay_out(&answer.counts.rows()));
    for slice in &answer.slices {
        say!(
            "slice {} = {:.1} mm: {} of {} points, {:.4} m2: {}",
            slice.axis.name(),
            slice.place_m * 1e3,
            slice.feasible,
            slice.points,
            slice.area_m2,
            slice.plot
        );
    }
}
