//! `mcdpr camera`: lists cameras, shows what one sees, records pictures.

use super::{Common, Failed, Outcome, print_json};
use crate::experiment::SimulatedRobot;
use crate::machine::Mismatch;
use crate::motion::Model;
use crate::pick::study::picking_robot;
use crate::pick::{SimulatedEye, workcell};
use mcdpr_simulator::camera::{Order, Tray};
use mcdpr_vision::recorded::{Recorded, Recording};
use mcdpr_vision::tag::{Options, detect};
use mcdpr_vision::{Frame, Source, align};
use miette::IntoDiagnostic as _;
use std::path::{Path, PathBuf};

/// Cameras: list them, show what one sees, record pictures
#[derive(Debug, clap::Args)]
pub(crate) struct Cmd {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// List the available cameras
    List,
    /// Take one picture and report what is in it
    Show(From),
    /// Write pictures into a folder that can be used as a camera (--record DIR)
    Record {
        #[command(flatten)]
        from: From,
        /// How many
        #[arg(long, default_value_t = 3)]
        count: usize,
    },
}

#[derive(Debug, clap::Args)]
struct From {
    /// `sim`, a recorded folder, `realsense` (a build with --features realsense), or a V4L2 device
    /// (to show its tags; a build with --features v4l2)
    #[arg(
        long,
        default_value = "sim",
        value_name = "sim|FOLDER|realsense|DEVICE"
    )]
    from: String,
    /// Objects in the simulated tray
    #[arg(long, default_value_t = 6)]
    objects: usize,
}

impl Cmd {
    pub(crate) fn run(&self, common: &Common) -> Outcome {
        match &self.what {
            What::List => list(common),
            What::Show(from) => show(common, from),
            What::Record { from, count } => record(common, from, *count),
        }
    }
}

fn list(common: &Common) -> Outcome {
    let mut cameras = vec![(
        "sim".to_owned(),
        "RGB-D, rendered: a D415 on the simulated platform".to_owned(),
    )];
    cameras.push((
        "realsense".to_owned(),
        if cfg!(feature = "realsense") {
            "RGB-D, a RealSense camera by librealsense2".to_owned()
        } else {
            "RGB-D, a RealSense camera; this build reads none: --features realsense".to_owned()
        },
    ));
    for number in 0..8 {
        let path = PathBuf::from(format!("/dev/video{number}"));
        if path.exists() {
            cameras.push((
                path.display().to_string(),
                if cfg!(feature = "v4l2") {
                    "a V4L2 device: colour only, for tags".to_owned()
                } else {
                    "a V4L2 device; this build reads none: --features v4l2".to_owned()
                },
            ));
        }
    }
    cameras.push((
        "FOLDER".to_owned(),
        "RGB-D, recorded with `mcdpr camera record`".to_owned(),
    ));
    if common.json {
        let cameras: Vec<_> = cameras
            .iter()
            .map(|(name, what)| serde_json::json!({ "name": name, "what": what }))
            .collect();
        return print_json(&cameras);
    }
    let rows: Vec<_> = cameras
        .into_iter()
        .map(|(name, what)| vec![name, what])
        .collect();
    super::write_out(&super::table::lay_out(&rows));
    Ok(())
}

/// The source that an argument names.
fn open(common: &Common, from: &From) -> miette::Result<Box<dyn Source>> {
    if from.from == "realsense" {
        return realsense(common);
    }
    if from.from != "sim" {
        let recorded = Recorded::open(Path::new(&from.from)).into_diagnostic()?;
        return Ok(Box::new(recorded));
    }
    let mut robot = picking_robot(&crate::robot::find(&common.robot)?);
    robot.tool.home_in_world_m = workcell::options(&robot)?.look_m;
    let model = Model::new(&robot)?;
    model.moves_in_space("the camera's view of a tray")?;
    let link = SimulatedRobot::new(Mismatch::realistic(), common.seed)
        .controller(&common.controller)
        .at_home(&model)?;
    let cell = workcell::cell(
        &robot,
        Tray::default(),
        Order::Separate,
        from.objects,
        common.seed,
    )?;
    link.with(|simulation| simulation.set_cell(cell));
    let mounting = workcell::Mounting::default();
    Ok(Box::new(SimulatedEye::new(
        link,
        &robot,
        &mounting,
        common.seed,
    )))
}

#[cfg(feature = "realsense")]
fn realsense(common: &Common) -> miette::Result<Box<dyn Source>> {
    let size_px = crate::robot::find(&common.robot)?.camera.lens.size_px;
    let camera = mcdpr_vision::realsense::RealSense::open(size_px).into_diagnostic()?;
    Ok(Box::new(camera))
}

#[cfg(not(feature = "realsense"))]
fn realsense(_: &Common) -> miette::Result<Box<dyn Source>> {
    let why = "this build has no support for RealSense: cargo build --release --features realsense";
    Err(Failed::from_error("opening the camera")(why).into())
}

#[cfg(all(feature = "v4l2", target_os = "linux"))]
fn show_device(common: &Common, path: &Path) -> Outcome {
    let camera = crate::robot::find(&common.robot)?.camera.lens;
    let size_px = camera.size_px;
    let mut device = mcdpr_vision::v4l2::V4l2::open(path, size_px).into_diagnostic()?;
    let picture = device.picture().into_diagnostic()?;
    let tags = detect(&picture.to_gray(), Some(&camera), &Options::default());
    let ids: Vec<u32> = tags.iter().map(|tag| tag.id).collect();
    if common.json {
        return print_json(&serde_json::json!({
            "camera": device.name(),
            "color_px": size_px,
            "tags": ids,
        }));
    }
    say!("{}: {} x {} px", device.name(), size_px[0], size_px[1]);
    say!("tags: {ids:?}");
    Ok(())
}

#[cfg(not(all(feature = "v4l2", target_os = "linux")))]
fn show_device(_: &Common, path: &Path) -> Outcome {
    let why = format!(
        "{}: this build has no support for V4L2 devices: cargo build --release --features v4l2 (Linux)",
        path.display()
    );
    Err(Failed::from_error("opening the camera")(why).into())
}

fn show(common: &Common, from: &From) -> Outcome {
    if from.from.starts_with("/dev/") {
        return show_device(common, Path::new(&from.from));
    }
    let mut source = open(common, from)?;
    let frame = source.frame().into_diagnostic()?;
    let picture = align(&frame);
    let mut depths: Vec<u16> = frame.depth.steps.pixels().to_vec();
    depths.retain(|&steps| steps > 0);
    depths.sort_unstable();
    let at = |share: f64| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "an index"
        )]
        let index = (share * depths.len().saturating_sub(1) as f64) as usize;
        depths
            .get(index)
            .map_or(0.0, |&steps| f64::from(steps) * frame.depth.unit_m)
    };
    let tags = detect(
        &frame.color.to_gray(),
        Some(&frame.cameras.color),
        &Options::default(),
    );
    let ids: Vec<u32> = tags.iter().map(|tag| tag.id).collect();
    let folder = match &common.record {
        Some(folder) => {
            keep(folder, source.as_ref(), std::slice::from_ref(&frame))?;
            Some(folder.display().to_string())
        }
        None => None,
    };
    if common.json {
        return print_json(&serde_json::json!({
            "camera": source.name(),
            "color_px": frame.cameras.color.size_px,
            "depth_px": frame.cameras.depth.size_px,
            "depth_share": frame.depth.measured_share(),
            "aligned_share": picture.depth.measured_share(),
            "nearest_m": at(0.0),
            "median_m": at(0.5),
            "farthest_m": at(1.0),
            "tags": ids,
            "folder": folder,
        }));
    }
    let [width, height] = frame.cameras.color.size_px;
    say!("{}: {width} x {height} px", source.name());
    say!(
        "distances at {:.1} % of the pixels ({:.1} % in the colour picture), {:.3} to {:.3} m, \
         half over {:.3} m",
        100.0 * frame.depth.measured_share(),
        100.0 * picture.depth.measured_share(),
        at(0.0),
        at(1.0),
        at(0.5)
    );
    say!(
        "tags: {}",
        if ids.is_empty() {
            "none".to_owned()
        } else {
            format!("{ids:?}")
        }
    );
    if let Some(folder) = folder {
        say!("written to {folder}");
    }
    Ok(())
}

fn record(common: &Common, from: &From, count: usize) -> Outcome {
    let mut source = open(common, from)?;
    let Some(folder) = &common.record else {
        return Err(
            Failed::from_error("recording pictures")("no folder was given: --record DIR").into(),
        );
    };
    let mut frames = Vec::new();
    for _ in 0..count.max(1) {
        frames.push(source.frame().into_diagnostic()?);
    }
    keep(folder, source.as_ref(), &frames)?;
    if common.json {
        return print_json(&serde_json::json!({ "folder": folder, "pictures": frames.len() }));
    }
    say!("{} pictures in {}", frames.len(), folder.display());
    Ok(())
}

fn keep(folder: &Path, source: &dyn Source, frames: &[Frame]) -> miette::Result<()> {
    let unit_m = frames.first().map_or(1e-3, |frame| frame.depth.unit_m);
    let mut recording = Recording::create(folder, &source.cameras(), unit_m).into_diagnostic()?;
    for frame in frames {
        recording.add(frame).into_diagnostic()?;
    }
    Ok(())
}
