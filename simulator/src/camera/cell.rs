//! The workcell around the robot: a tray with objects that the gripper moves, and the camera that
//! hangs on the platform.

use super::arrange::{Tray, fall, lies_on};
use super::color::{ColorPicture, Optics, render_color};
use super::depth::{DepthPicture, Stereo, render_depth};
use super::frame::Frame;
use super::grasp::{Grip, Gripper};
use super::lens::Lens;
use super::scene::Scene;
use super::tracer::Tracer;
use crate::plant::vec3::axpy;
use crate::plant::{Plant, PlantError};

/// An RGB-D camera on the platform.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rgbd {
    /// Colour lens.
    pub color: Lens,
    /// Depth lens.
    pub depth: Lens,
    /// The colour camera on the platform.
    pub platform_from_color: Frame,
    /// The depth camera beside the colour camera.
    pub color_from_depth: Frame,
    /// The colour camera's faults.
    pub optics: Optics,
    /// The depth camera's faults.
    pub stereo: Stereo,
}

/// Stiffness of what an object lies on and of the pads that hold it, in series, N/m; assumption: rubber pads of a
/// square centimetre and some millimetres have 10 to 50 N/mm.
const GROUND_N_PER_M: f64 = 2e4;
/// Position of removed bodies: out of sight, m.
const FAR_BELOW_M: f64 = 10.0;

/// One event in the cell.
#[derive(Debug, Clone, PartialEq)]
pub struct CellEvent {
    /// Simulated time, s.
    pub time_s: f64,
    /// The object, or an empty text.
    pub object: String,
    /// The result of closing the jaws.
    pub grip: Grip,
}

/// Tray, objects, gripper and camera. [`Cell::step`] lets the gripper act on the objects.
#[derive(Debug, Clone, PartialEq)]
pub struct Cell {
    /// The tray.
    pub tray: Tray,
    /// All visible bodies; the first `fixed` ones do not move.
    pub scene: Scene,
    /// The gripper.
    pub gripper: Gripper,
    /// Tool point on the platform, m.
    pub tcp_m: [f64; 3],
    /// Turn of the jaws about the tool's axis, rad: set by a wrist, if there is one.
    pub wrist_rad: f64,
    fixed: usize,
    closed_since_s: Option<f64>,
    judged: bool,
    held: Option<(usize, Frame)>,
    /// Height at which the held object still lies on its ground, and the point of the platform that carries it;
    /// `None` once it hangs.
    lies: Option<(f64, [f64; 3])>,
    carried_off: Vec<String>,
    log: Vec<CellEvent>,
}

impl Cell {
    /// A cell whose scene starts with the tray's own bodies.
    #[must_use]
    pub fn new(tray: Tray, scene: Scene, gripper: Gripper, tcp_m: [f64; 3]) -> Self {
        Self {
            fixed: tray.bodies().len().min(scene.bodies.len()),
            tray,
            scene,
            gripper,
            tcp_m,
            wrist_rad: 0.0,
            closed_since_s: None,
            judged: false,
            held: None,
            lies: None,
            carried_off: Vec::new(),
            log: Vec::new(),
        }
    }

    /// Pose of the tool, jaws along its y.
    #[must_use]
    pub fn world_from_tool(&self, world_from_platform: &Frame) -> Frame {
        let tool = Frame::from_rpy(self.tcp_m, [0.0, 0.0, self.wrist_rad]);
        world_from_platform.then(&tool)
    }

    /// Number of objects in the tray.
    #[must_use]
    pub fn left_in_tray(&self) -> usize {
        let held = self.held.map(|(index, _)| index);
        let objects = self.scene.bodies.iter().enumerate().skip(self.fixed);
        objects
            .filter(|(index, body)| {
                Some(*index) != held && self.tray.holds(body.world_from_body.position_m)
            })
            .count()
    }

    /// Name of the object in the jaws.
    #[must_use]
    pub fn held(&self) -> Option<&str> {
        let (index, _) = self.held?;
        Some(&self.scene.bodies[index].name)
    }

    /// Bodies that can move.
    #[must_use]
    pub fn objects(&self) -> &[super::scene::Body] {
        &self.scene.bodies[self.fixed..]
    }

    /// Multiplies the mass of every object.
    pub fn make_heavier(&mut self, factor: f64) {
        for body in self.scene.bodies.iter_mut().skip(self.fixed) {
            body.mass_kg *= factor;
        }
    }

    /// Results of all closings of the jaws so far.
    #[must_use]
    pub fn log(&self) -> &[CellEvent] {
        &self.log
    }

    /// Updates the gripper: called once per tick.
    ///
    /// # Errors
    /// The plant's, if its state is no longer valid.
    pub fn step(&mut self, plant: &mut Plant) -> Result<(), PlantError> {
        let now_s = plant.time_s();
        if !plant.gripper_closed() {
            if self.closed_since_s.take().is_some() {
                self.judged = false;
                plant.set_gripper_switch(false);
                self.release(plant)?;
            }
            return Ok(());
        }
        let since_s = *self.closed_since_s.get_or_insert(now_s);
        self.take_up(plant)?;
        // Judged once, when the jaws have had their time: later motion does not change the grip.
        if self.judged || now_s - since_s < self.gripper.close_s {
            return Ok(());
        }
        self.judged = true;
        let tool = self.world_from_tool(&plant.truth()?.pose.into());
        let grip = self.gripper.close(&self.scene.bodies, &tool);
        let mut object = String::new();
        if let Grip::Held { body, shift_m, .. } = grip {
            object.clone_from(&self.scene.bodies[body].name);
            // The jaws centre what they hold.
            let place = &mut self.scene.bodies[body].world_from_body;
            let aside = tool.direction([0.0, shift_m, 0.0]);
            for (value, shift) in place.position_m.iter_mut().zip(aside) {
                *value += shift;
            }
            self.held = Some((body, tool.inverse().then(place)));
            let at_m = self.scene.bodies[body].world_from_body.position_m;
            let point = Frame::from(plant.truth()?.pose).point_inside(at_m);
            // Its ground carries it until it is lifted.
            self.lies = Some((at_m[2], point));
        }
        // The switch reports that the jaws met each other.
        plant.set_gripper_switch(!matches!(grip, Grip::Held { .. }));
        self.log.push(CellEvent {
            time_s: now_s,
            object,
            grip,
        });
        Ok(())
    }

    /// The held object leaves its ground as it is lifted: until then a part of its weight rests there. By and by it
    /// hangs on the platform by its centre of mass: cables and drives feel it.
    fn take_up(&mut self, plant: &mut Plant) -> Result<(), PlantError> {
        let (Some((index, _)), Some((ground_m, point))) = (self.held, self.lies) else {
            return Ok(());
        };
        let weight_n = 9.81 * self.scene.bodies[index].mass_kg;
        let height_m = Frame::from(plant.truth()?.pose).point(point)[2];
        // Pressed down, it pushes back, as hard as the pads hold.
        let taken_n = (GROUND_N_PER_M * (height_m - ground_m)).clamp(-weight_n, weight_n);
        if taken_n >= weight_n {
            self.lies = None;
        }
        plant.set_load([0.0, 0.0, -taken_n], point, [0.0; 3])
    }

    fn release(&mut self, plant: &mut Plant) -> Result<(), PlantError> {
        let Some((index, tool_from_body)) = self.held.take() else {
            return Ok(());
        };
        self.lies = None;
        plant.set_load([0.0; 3], [0.0; 3], [0.0; 3])?;
        let tool = self.world_from_tool(&plant.truth()?.pose.into());
        let mut body = self.scene.bodies[index].clone();
        body.world_from_body = tool.then(&tool_from_body);
        let others: Vec<_> = self.others(index);
        if self.tray.holds(body.world_from_body.position_m) {
            fall(&others, &mut body, self.tray.center_m[2]);
        } else {
            // A body that is put down beside the tray is removed.
            self.carried_off.push(body.name.clone());
            body.world_from_body.position_m[2] -= FAR_BELOW_M;
        }
        self.scene.bodies[index] = body;
        Ok(())
    }

    /// Names of the objects that were put down beside the tray.
    #[must_use]
    pub fn carried_off(&self) -> &[String] {
        &self.carried_off
    }

    /// The point of the scene that a colour camera sees at a pixel, world, m.
    #[must_use]
    pub fn seen_at(
        &self,
        camera: &Rgbd,
        world_from_platform: &Frame,
        pixel: [f64; 2],
    ) -> Option<[f64; 3]> {
        let color = world_from_platform.then(&camera.platform_from_color);
        let ray = camera.color.ray(pixel);
        let hit = Tracer::new(&self.scene, &color).cast(ray)?;
        Some(axpy(color.position_m, hit.way, color.direction(ray)))
    }

    fn others(&self, index: usize) -> Vec<super::scene::Body> {
        let bodies = self.scene.bodies.iter().enumerate().skip(self.fixed);
        bodies
            .filter(|(other, _)| *other != index)
            .map(|(_, body)| body.clone())
            .collect()
    }

    /// The present scene with the platform at a pose: a held object hangs in the jaws, and objects
    /// that lay on it have fallen.
    pub fn update(&mut self, world_from_platform: &Frame) {
        let Some((index, tool_from_body)) = self.held else {
            return;
        };
        let lifted = self
            .world_from_tool(world_from_platform)
            .then(&tool_from_body);
        let before = self.scene.bodies[index].clone();
        self.scene.bodies[index].world_from_body = lifted;
        for other in self.fixed..self.scene.bodies.len() {
            if other != index && lies_on(&self.scene.bodies[other], &before) {
                let below: Vec<_> = (self.fixed..self.scene.bodies.len())
                    .filter(|k| *k != other && *k != index)
                    .map(|k| self.scene.bodies[k].clone())
                    .collect();
                let mut body = self.scene.bodies[other].clone();
                fall(&below, &mut body, self.tray.center_m[2]);
                self.scene.bodies[other] = body;
            }
        }
    }

    /// A colour and a depth picture with the platform at a place.
    #[must_use]
    pub fn look(
        &self,
        camera: &Rgbd,
        world_from_platform: &Frame,
        seed: u64,
    ) -> (ColorPicture, DepthPicture) {
        let color = world_from_platform.then(&camera.platform_from_color);
        let depth = color.then(&camera.color_from_depth);
        (
            render_color(&self.scene, &camera.color, &color, &camera.optics, seed),
            render_depth(&self.scene, &camera.depth, &depth, &camera.stereo, seed),
        )
    }
}

impl Rgbd {
    /// A RealSense D415 at 640 x 480: the colour camera 15 mm beside the left infrared imager, a
    /// depth lens of its own, a small turn between the two.
    #[must_use]
    pub fn d415(color: Lens, platform_from_color: Frame) -> Self {
        Self {
            color,
            depth: Lens {
                size_px: [640, 480],
                focal_px: [607.0, 607.0],
                center_px: [322.5, 237.5],
                distortion: [0.0; 5],
            },
            platform_from_color,
            color_from_depth: Frame::from_rpy([0.015, 0.0002, -0.0004], [0.002, -0.003, 0.0015]),
            optics: Optics::default(),
            stereo: Stereo::default(),
        }
    }
}
