//! Writes the pictures of the simulated robot's camera into a folder for another program.

use crate::cli::Failed;
use crate::link::SimulatedLink;
use crate::pick::workcell;
use crate::robot::Robot;
use crate::sight::{Scene, SceneCamera};
use mcdpr_simulator::camera::{Cell, Frame as Place, Order, Rgbd, Tray};
use mcdpr_vision::live::{LiveWriter, now_s};
use mcdpr_vision::{Cameras, DepthImage, Image, RgbImage, SourceError};
use nalgebra::Isometry3;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Polling interval for a request.
const LOOK_EVERY: Duration = Duration::from_millis(5);

/// One picture to be made: its time, camera pose, and scene.
struct Job {
    taken_s: f64,
    platform: Place,
    cell: Option<Cell>,
}

/// The camera: pictures are rendered on a separate thread, because the robot's time must continue.
pub(in crate::cli) struct Eye {
    wanted: Arc<AtomicBool>,
    jobs: Sender<Job>,
    failed: Arc<Mutex<Option<SourceError>>>,
    thread: JoinHandle<()>,
}

/// Renderer of a job.
enum Lens {
    /// Tags on the floor.
    Tags(Box<SceneCamera>),
    /// A tray, with distances.
    Tray(Box<Rgbd>, u64),
}

/// The scene below the robot.
pub(in crate::cli) struct Below {
    /// Objects in a tray on printed tags; else the robot's tags on the floor.
    pub(in crate::cli) objects: Option<usize>,
    /// Whether the camera's pose is as in the robot file.
    pub(in crate::cli) ideal: bool,
}

impl Eye {
    /// Puts tags or a tray under a robot and writes its camera's pictures into a folder.
    ///
    /// # Errors
    /// A folder that cannot be written; a robot without gripper or depth camera, for a tray.
    pub(in crate::cli) fn start(
        folder: &Path,
        robot: &Robot,
        link: &SimulatedLink,
        below: &Below,
        seed: u64,
    ) -> miette::Result<Self> {
        let scene = if below.ideal {
            Scene::on_floor(robot, 0.0, 0.0, seed)
        } else {
            Scene::of(robot, seed)
        };
        let (lens, cameras, unit_m) = match below.objects {
            None => tags(scene, seed),
            Some(count) => {
                let cell = workcell::cell(
                    robot,
                    Tray::default().with_mat(),
                    Order::Separate,
                    count,
                    seed,
                )?;
                link.with(|simulation| simulation.set_cell(cell));
                tray(robot, &scene, seed)
            }
        };
        let writer = LiveWriter::create(folder, &cameras, unit_m);
        let writer = writer.map_err(Failed::from_error("the camera's folder"))?;
        let (jobs, todo) = channel::<Job>();
        let wanted = Arc::new(AtomicBool::new(false));
        let failed = Arc::new(Mutex::new(None));
        let shared = (Arc::clone(&wanted), Arc::clone(&failed));
        let work = move || {
            let (wanted, failed) = shared;
            let mut maker = Maker {
                lens,
                writer,
                shown: 0,
            };
            loop {
                if maker.writer.is_wanted() {
                    wanted.store(true, Ordering::Release);
                }
                let job = match todo.recv_timeout(LOOK_EVERY) {
                    Ok(job) => job,
                    Err(std::sync::mpsc::RecvTimeoutError::Timeout) => continue,
                    Err(std::sync::mpsc::RecvTimeoutError::Disconnected) => return,
                };
                if let Err(error) = maker.make(&job) {
                    *failed.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                    return;
                }
            }
        };
        // One thread for pictures: the robot keeps real time.
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
        let pool = pool.map_err(Failed::from_error("a thread for pictures"))?;
        let thread = std::thread::Builder::new().name("pictures".to_owned());
        let thread = thread
            .spawn(move || pool.install(work))
            .map_err(Failed::from_error("a thread for pictures"))?;
        Ok(Self {
            wanted,
            jobs,
            failed,
            thread,
        })
    }

    /// Takes the requested picture, if there is a request.
    ///
    /// # Errors
    /// The error that ended the camera.
    pub(in crate::cli) fn look(&self, link: &SimulatedLink) -> Result<(), Failed> {
        // One picture for each request, however often this is called.
        if self.wanted.swap(false, Ordering::AcqRel) {
            let seen = link.with(|simulation| {
                let platform = Place::from(simulation.plant().truth()?.pose);
                let cell = simulation.cell_mut().map(|cell| {
                    // A held object hangs at the present position of the jaws.
                    cell.update(&platform);
                    cell.clone()
                });
                Ok::<_, mcdpr_simulator::plant::PlantError>((platform, cell))
            });
            let (platform, cell) = seen.map_err(Failed::from_error("taking a picture"))?;
            // The reason for the end of the thread is reported below.
            let _ = self.jobs.send(Job {
                taken_s: now_s(),
                platform,
                cell,
            });
        }
        if self.thread.is_finished() {
            let failed = self.failed.lock().unwrap_or_else(PoisonError::into_inner);
            let reason = failed
                .as_ref()
                .map_or_else(|| "its thread ended".to_owned(), ToString::to_string);
            return Err(Failed::from_error("the camera's folder")(reason));
        }
        Ok(())
    }
}

/// Renders pictures and writes them.
struct Maker {
    lens: Lens,
    writer: LiveWriter,
    shown: u64,
}

impl Maker {
    fn make(&mut self, job: &Job) -> Result<(), SourceError> {
        let failed = |reason: String| SourceError::Device {
            name: "simulated".to_owned(),
            reason,
        };
        self.shown += 1;
        match (&mut self.lens, &job.cell) {
            (Lens::Tray(rgbd, seed), Some(cell)) => {
                let seed = seed.wrapping_mul(1_000_003).wrapping_add(self.shown);
                let (color, depth) = cell.look(rgbd, &job.platform, seed);
                let color = RgbImage::new(color.width, color.height, color.pixels);
                let steps = Image::new(depth.width, depth.height, depth.steps);
                let depth = DepthImage {
                    steps: steps.map_err(|error| failed(error.to_string()))?,
                    unit_m: depth.unit_m,
                };
                let color = color.map_err(|error| failed(error.to_string()))?;
                self.writer.add(job.taken_s, &color, Some(&depth))
            }
            (Lens::Tags(camera), _) => {
                let picture = camera.picture(&job.platform);
                let picture = picture.map_err(|error| failed(error.to_string()))?;
                self.writer.add(job.taken_s, &picture, None)
            }
            (Lens::Tray(..), None) => Err(failed("there is no tray".to_owned())),
        }
    }
}

/// The unit of the simulated depth camera, m.
const UNIT_M: f64 = 1e-4;

fn tags(scene: Scene, seed: u64) -> (Lens, Cameras, f64) {
    let color = scene.lens;
    let cameras = Cameras {
        color,
        depth: color,
        color_from_depth: Isometry3::identity(),
    };
    let camera = Box::new(SceneCamera::new(scene, seed));
    (Lens::Tags(camera), cameras, UNIT_M)
}

fn tray(robot: &Robot, scene: &Scene, seed: u64) -> (Lens, Cameras, f64) {
    let camera_from_platform = Isometry3::from(scene.camera_from_platform);
    let rgbd = workcell::d415(robot, &camera_from_platform.inverse());
    let cameras = workcell::cameras_of(&rgbd);
    (Lens::Tray(Box::new(rgbd), seed), cameras, UNIT_M)
}
