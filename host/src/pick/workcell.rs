//! The simulated workcell: a tray of objects under the simulated robot, and its camera.

use super::budget::Uncertainty;
use super::choose::Choice;
use super::mat::{Mat, SheetTag};
use super::place::Places;
use super::task::{Options, Watcher};
use crate::link::SimulatedLink;
use crate::motion::Model;
use crate::robot::{GripperKind, Robot};
use crate::sight::{Scene, Shown};
use mcdpr_simulator::camera::{
    Cell, Frame as Place, Gripper, Lens, Order, Rgbd, TagRows, Tray, render_color,
};
use mcdpr_vision::grasp::Hand;
use mcdpr_vision::{Camera, Cameras, DepthImage, Frame, Image, RgbImage, Source, SourceError};
use nalgebra::{Isometry3, Matrix2, Matrix3, Rotation3, Translation3, Vector2, Vector3};

use super::PickError;

/// Size of the pictures that picking uses, px.
const PICTURE_PX: [usize; 2] = [640, 480];

/// Error of the simulated camera's mounting, half widths per axis.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mounting {
    /// Shift, m.
    pub shift_m: f64,
    /// Turn, rad.
    pub turn_rad: f64,
}

/// The simulated camera on the platform, as a source of pictures.
pub(crate) struct SimulatedEye {
    link: SimulatedLink,
    camera: Rgbd,
    seed: u64,
    taken: u64,
}

impl SimulatedEye {
    /// A D415 at the robot file's camera pose, off by `mounting` drawn with `seed`; for a robot
    /// that was calibrated on the simulator, at that machine's true pose.
    #[must_use]
    pub fn new(link: SimulatedLink, robot: &Robot, mounting: &Mounting, seed: u64) -> Self {
        let mut random = mcdpr_core::random::Random::new(seed ^ 0x6579_6500);
        let shift = Vector3::from_fn(|_, _| random.within(mounting.shift_m));
        let turn = Vector3::from_fn(|_, _| random.within(mounting.turn_rad));
        let off = Isometry3::new(shift, turn);
        let platform_from_color = match &robot.calibrated {
            Some(_) => Isometry3::from(Scene::of(robot, seed).camera_from_platform).inverse(),
            None => Isometry3::from(robot.camera.camera_from_platform).inverse() * off,
        };
        // A calibrated file has the estimated lens; the simulated machine keeps its own.
        let truly = robot.calibrated.as_ref().map_or(robot, |c| &c.designed);
        Self {
            link,
            camera: d415(truly, &platform_from_color),
            seed,
            taken: 0,
        }
    }

    fn next_seed(&mut self) -> u64 {
        // A large prime: the pictures of neighbouring seeds have no noise in common.
        let seed = self.seed.wrapping_mul(1_000_003).wrapping_add(self.taken);
        self.taken += 1;
        seed
    }

    /// The simulated camera's true state.
    #[must_use]
    pub const fn camera(&self) -> &Rgbd {
        &self.camera
    }
}

/// The simulated D415 at a pose on the platform, with the colour lens of a robot file.
#[must_use]
pub fn d415(robot: &Robot, platform_from_color: &Isometry3<f64>) -> Rgbd {
    Rgbd::d415(lens(&color_camera(robot)), place(platform_from_color))
}

/// The reported parameters of a simulated depth camera.
#[must_use]
pub(crate) fn cameras_of(rgbd: &Rgbd) -> Cameras {
    Cameras {
        color: camera(&rgbd.color),
        depth: camera(&rgbd.depth),
        color_from_depth: isometry_of(&rgbd.color_from_depth),
    }
}

/// The colour camera of a robot file in the mode that picking uses.
#[must_use]
pub(crate) fn color_camera(robot: &Robot) -> Camera {
    robot.camera.lens.mode(PICTURE_PX)
}

impl Source for SimulatedEye {
    fn name(&self) -> String {
        "simulated D415 on the platform".to_owned()
    }

    fn cameras(&self) -> Cameras {
        cameras_of(&self.camera)
    }

    fn color(&mut self) -> Result<RgbImage, SourceError> {
        let seed = self.next_seed();
        let rgbd = self.camera;
        let color = self.link.with(|simulation| {
            let truth = simulation.plant().truth();
            let pose = truth.map_err(|error| failed(error.to_string()))?.pose;
            let cell = simulation.cell().ok_or_else(no_cell)?;
            let place = Place::from(pose).then(&rgbd.platform_from_color);
            Ok::<_, SourceError>(render_color(
                &cell.scene,
                &rgbd.color,
                &place,
                &rgbd.optics,
                seed,
            ))
        })?;
        RgbImage::new(color.width, color.height, color.pixels)
            .map_err(|error| failed(error.to_string()))
    }

    fn frame(&mut self) -> Result<Frame, SourceError> {
        let seed = self.next_seed();
        let rgbd = self.camera;
        let (color, depth) = self.link.with(|simulation| {
            let pose = simulation
                .plant()
                .truth()
                .map_err(|e| failed(e.to_string()))?;
            let cell = simulation.cell().ok_or_else(no_cell)?;
            Ok::<_, SourceError>(cell.look(&rgbd, &pose.pose.into(), seed))
        })?;
        let sized = |error: mcdpr_vision::image::SizeError| failed(error.to_string());
        let frame = Frame {
            color: RgbImage::new(color.width, color.height, color.pixels).map_err(sized)?,
            depth: DepthImage {
                steps: Image::new(depth.width, depth.height, depth.steps).map_err(sized)?,
                unit_m: depth.unit_m,
            },
            cameras: self.cameras(),
        };
        let number = usize::try_from(self.taken).unwrap_or(usize::MAX);
        frame.checked().map_err(|reason| SourceError::Frame {
            name: self.name(),
            number,
            reason,
        })
    }
}

fn failed(reason: String) -> SourceError {
    SourceError::Device {
        name: "simulated D415".to_owned(),
        reason,
    }
}

fn no_cell() -> SourceError {
    failed("there is no workcell to be seen".to_owned())
}

fn camera(lens: &Lens) -> Camera {
    Camera {
        size_px: lens.size_px,
        focal_px: lens.focal_px,
        center_px: lens.center_px,
        distortion: lens.distortion,
    }
}

fn lens(camera: &Camera) -> Lens {
    Lens {
        size_px: camera.size_px,
        focal_px: camera.focal_px,
        center_px: camera.center_px,
        distortion: camera.distortion,
    }
}

/// A frame of the simulator as an isometry.
#[must_use]
pub(crate) fn isometry_of(place: &Place) -> Isometry3<f64> {
    let rotation = Matrix3::from_fn(|i, j| place.rotation[i][j]);
    Isometry3::from_parts(
        Translation3::from(Vector3::from(place.position_m)),
        Rotation3::from_matrix_unchecked(rotation).into(),
    )
}

/// An isometry as a frame of the simulator.
#[must_use]
pub fn place(pose: &Isometry3<f64>) -> Place {
    let m = pose.rotation.to_rotation_matrix();
    Place {
        rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[(i, j)])),
        position_m: pose.translation.vector.into(),
    }
}

/// The gripper of a robot file with the assumed sizes of its jaws.
///
/// # Errors
/// [`PickError::NoGripper`], [`PickError::NoDepth`].
pub(crate) fn gripper_of(robot: &Robot) -> Result<(Gripper, Hand), PickError> {
    let name = || robot.name.clone();
    if robot.gripper.kind == GripperKind::None {
        return Err(PickError::NoGripper { robot: name() });
    }
    if !robot.camera.depth {
        return Err(PickError::NoDepth { robot: name() });
    }
    let gripper = Gripper {
        opening_m: robot.gripper.stroke_m,
        close_s: robot.gripper.close_s,
        ..Gripper::default()
    };
    let hand = Hand {
        opening_m: gripper.opening_m,
        pad_half_width_m: gripper.pad_half_width_m,
        below_m: gripper.below_m,
        above_m: gripper.above_m,
        finger_m: gripper.finger_m,
        ..Hand::default()
    };
    Ok((gripper, hand))
}

/// A tray with objects under a simulated robot.
///
/// # Errors
/// As [`gripper_of`].
pub fn cell(
    robot: &Robot,
    tray: Tray,
    order: Order,
    count: usize,
    seed: u64,
) -> Result<Cell, PickError> {
    let (gripper, _) = gripper_of(robot)?;
    let tcp_m = robot.tool.tcp_in_platform_m.into();
    Ok(Cell::new(
        tray,
        tray.scene(order, count, seed),
        gripper,
        tcp_m,
    ))
}

/// The tags of a tray's floor, as the program knows them.
#[must_use]
pub fn mat(rows: &TagRows) -> Mat {
    let mut tags = Vec::new();
    for row in 0..rows.count[1] {
        for column in 0..rows.count[0] {
            let [x, y] = rows.middle_m([column, row]);
            let half = 0.5 * rows.size_m;
            let corner = |i: f64, j: f64| Vector3::new(x + i * half, y + j * half, 0.0);
            let corners = [
                corner(-1.0, -1.0),
                corner(1.0, -1.0),
                corner(1.0, 1.0),
                corner(-1.0, 1.0),
            ];
            let id = rows.first + row * rows.count[0] + column;
            tags.push(SheetTag {
                id: u32::try_from(id).unwrap_or(u32::MAX),
                corners_m: corners,
            });
        }
    }
    Mat { tags }
}

/// The picking task of the simulated workcell.
///
/// # Errors
/// As [`gripper_of`]; [`PickError::NoRoom`].
pub fn options(robot: &Robot) -> Result<Options, PickError> {
    let (_, hand) = gripper_of(robot)?;
    let places = Places::of(robot)?;
    let [hand_eye_m, hand_eye_rad] =
        crate::calibration::result::camera_sd(robot).unwrap_or(HAND_EYE_SD);
    let tray = places.tray();
    Ok(Options {
        look_m: places.look_m,
        more_views_m: Vec::new(),
        near_m: Some(NEAR_M),
        probe_px: None,
        release_m: places.release_m,
        return_m: None,
        tray_m: places.tray_m,
        tray_half_m: tray.half_m.map(|half| half - 0.006),
        above_m: 0.08,
        hand,
        turns: true,
        failures_max: 3,
        attempts_max: 40,
        uncertainty: Uncertainty {
            hand_eye_m,
            hand_eye_rad,
            anchors_m: 2e-4,
            // sqrt(0.04^2 + 0.05^2) px: fine and coarse noise of the simulated camera together.
            disparity_px: 0.064,
            // 607 px x 55 mm, as of the simulated D415.
            focal_baseline_px_m: 607.0 * 0.055,
        },
        mat: None,
    })
}

/// Standard deviation of the camera's place on the platform where no calibration states it, m and rad: that
/// of a calibrated `lab-fast`.
const HAND_EYE_SD: [f64; 2] = [1e-4, 5e-4];

/// Margin of the fingers when the mat gives their position, m.
pub(crate) const MARGIN_BY_MAT_M: f64 = 0.002;

/// Positions around the first view from which a tray is seen too, m.
const VIEWS_M: [[f64; 2]; 2] = [[0.0, 0.04], [-0.03, -0.03]];

/// More views for a task: `count` in all, three at most.
pub(crate) fn look_from(options: &mut Options, count: usize) {
    let more = VIEWS_M.iter().take(count.saturating_sub(1));
    options.more_views_m = more
        .map(|[x, y]| options.look_m + Vector3::new(*x, *y, 0.0))
        .collect();
}

/// Height of the tool over a grasp that is looked at again, m: the camera is then 0.32 m over it,
/// about the nearest at which a D415 measures at 640 x 480.
const NEAR_M: f64 = 0.25;

/// The paper's grasp point, world, m.
pub(crate) const PAPER_GRASP_M: [f64; 3] = [0.252, -0.039, -0.517];
/// Its pixel, px.
pub(crate) const PAPER_PIXEL: [f64; 2] = [360.0, 285.0];
/// Where the paper's robot releases, world, m.
pub(crate) const PAPER_RELEASE_M: [f64; 3] = [0.335, 0.1, -0.51];
/// Where the paper's robot returns to, world, m.
pub(crate) const PAPER_RETURN_M: [f64; 3] = [0.335, 0.0, -0.009];

/// The paper's task: one box of 28 mm whose top's middle is the paper's grasp point, seen from
/// where that point lies at the paper's pixel, released and returned at the paper's positions.
///
/// # Errors
/// As [`options`]; if the robot cannot hang there.
pub fn paper(model: &Model) -> Result<(Cell, Options), PickError> {
    let robot = model.robot();
    let (gripper, _) = gripper_of(robot)?;
    let tray = Tray::default();
    let kinds = mcdpr_simulator::camera::kinds();
    let mut scene = mcdpr_simulator::camera::Scene {
        bodies: tray.bodies(),
        ..Default::default()
    };
    if let Some(kind) = kinds.iter().find(|kind| kind.body.name == "small box") {
        let mut body = kind.body.clone();
        let [x, y, z] = PAPER_GRASP_M;
        let middle_m = 0.5 * (z + tray.center_m[2]);
        body.world_from_body = Place::from_rpy([x, y, middle_m], [0.0, 0.0, 0.3]);
        scene.bodies.push(body);
    }
    let tcp_m = robot.tool.tcp_in_platform_m.into();
    let mut options = options(robot)?;
    options.probe_px = Some(PAPER_PIXEL);
    options.return_m = Some(PAPER_RETURN_M.into());
    options.attempts_max = 3;
    options.release_m = PAPER_RELEASE_M.into();
    // Look position: Newton's method on the two coordinates that move the pixel.
    let camera = color_camera(robot);
    let platform_from_camera = Isometry3::from(robot.camera.camera_from_platform).inverse();
    let pixel = |tool_m: &Vector3<f64>| -> Result<Vector2<f64>, PickError> {
        let rest = model.rest(tool_m, None)?;
        let world_from_camera = super::arm::isometry(&rest) * platform_from_camera;
        let point = world_from_camera.inverse_transform_point(&PAPER_GRASP_M.into());
        Ok(camera
            .project(&point)
            .unwrap_or_else(|| Vector2::from(camera.center_px)))
    };
    // Slopes by differences over a millimetre.
    let step_m = 1e-3;
    for _ in 0..6 {
        let here = pixel(&options.look_m)?;
        let right = pixel(&(options.look_m + Vector3::x() * step_m))? - here;
        let up = pixel(&(options.look_m + Vector3::y() * step_m))? - here;
        let slope = Matrix2::from_columns(&[right, up]) / step_m;
        if let Some(inverse) = slope.try_inverse() {
            let way = inverse * (Vector2::from(PAPER_PIXEL) - here);
            options.look_m += Vector3::new(way.x, way.y, 0.0);
        }
    }
    Ok((Cell::new(tray, scene, gripper, tcp_m), options))
}

/// The watcher of a simulated cell: turns the wrist, records the true state.
pub(crate) struct CellObserver {
    link: SimulatedLink,
    camera: Rgbd,
    looked_from: Vec<Place>,
    ideal_m: Option<Vector3<f64>>,
    /// Vector from the true grasp point to the true tool, at each closing, world, m.
    pub off_m: Vec<Vector3<f64>>,
    /// The first picture in which a grasp was chosen.
    pub first_look: Option<Shown>,
}

impl CellObserver {
    /// Watches the cell behind a link.
    #[must_use]
    pub const fn new(link: SimulatedLink, camera: Rgbd) -> Self {
        Self {
            link,
            camera,
            looked_from: Vec::new(),
            ideal_m: None,
            off_m: Vec::new(),
            first_look: None,
        }
    }

    /// Another picker goes on: it counts its pictures from the first.
    pub(crate) fn continue_with_another(&mut self) {
        self.looked_from.clear();
    }

    fn pose(&self) -> Option<Place> {
        self.link
            .with(|simulation| simulation.plant().truth().ok())
            .map(|truth| truth.pose.into())
    }
}

impl Watcher for CellObserver {
    fn pictured(&mut self) {
        let pose = self.pose().unwrap_or_default();
        self.looked_from.push(pose);
    }

    fn looked(&mut self, picture: &Shown) {
        self.first_look.get_or_insert_with(|| picture.clone());
    }

    fn chosen(&mut self, choice: &Choice) {
        let pixel = choice.grasp.pixel.into();
        let camera = self.camera;
        let looked_from = self.looked_from.get(choice.view).copied();
        let seen = self.link.with(|simulation| {
            let cell = simulation.cell_mut()?;
            cell.wrist_rad = choice.wrist_rad;
            cell.seen_at(&camera, &looked_from?, pixel)
        });
        // From the top of the object at the grasp's pixel to the target of the tool.
        let down = Vector3::new(0.0, 0.0, choice.grasp.top_m - choice.grasp.height_m);
        let moved = choice.tool_m - choice.seen_m;
        self.ideal_m = seen.map(|top| Vector3::from(top) - down + moved);
    }

    fn closing(&mut self, _: &Choice) {
        let tool = self
            .link
            .with(|simulation| simulation.plant().truth().ok())
            .map(|truth| Vector3::from(truth.tool_position_m));
        if let (Some(tool), Some(ideal)) = (tool, self.ideal_m) {
            self.off_m.push(tool - ideal);
        }
    }

    fn lifted(&mut self) {
        let Some(pose) = self.pose() else { return };
        self.link.with(|simulation| {
            if let Some(cell) = simulation.cell_mut() {
                cell.update(&pose);
            }
        });
    }
}
