//! The simulator's pictures in this crate's types.

use mcdpr_simulator::camera::Gripper;
use mcdpr_simulator::camera::{
    Cell, ColorPicture, DepthPicture, Frame as Place, Lens, Order, Rgbd, Tray,
};
use mcdpr_vision::{Camera, Cameras, DepthImage, Frame, Image, RgbImage};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, Vector3};

pub fn isometry(place: &Place) -> Isometry3<f64> {
    let rotation = Matrix3::from_fn(|i, j| place.rotation[i][j]);
    Isometry3::from_parts(
        Translation3::from(Vector3::from(place.position_m)),
        Rotation3::from_matrix_unchecked(rotation).into(),
    )
}

pub fn place(pose: &Isometry3<f64>) -> Place {
    let m = pose.rotation.to_rotation_matrix();
    Place {
        rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[(i, j)])),
        position_m: pose.translation.vector.into(),
    }
}

pub fn camera(lens: &Lens) -> Camera {
    Camera {
        size_px: lens.size_px,
        focal_px: lens.focal_px,
        center_px: lens.center_px,
        distortion: lens.distortion,
    }
}

pub fn frame(rgbd: &Rgbd, pictures: (ColorPicture, DepthPicture)) -> Frame {
    let (color, depth) = pictures;
    Frame {
        color: RgbImage::new(color.width, color.height, color.pixels).unwrap(),
        depth: DepthImage {
            steps: Image::new(depth.width, depth.height, depth.steps).unwrap(),
            unit_m: depth.unit_m,
        },
        cameras: Cameras {
            color: camera(&rgbd.color),
            depth: camera(&rgbd.depth),
            color_from_depth: isometry(&rgbd.color_from_depth),
        },
    }
}

/// A D415 of 640 x 480 that looks down on the tray from 0.4 m, a little tilted.
pub fn look() -> (Rgbd, Place) {
    let color = Lens {
        size_px: [640, 480],
        focal_px: [613.3, 613.3],
        center_px: [320.0, 240.0],
        distortion: [0.0; 5],
    };
    let center = Tray::default().center_m;
    let position = [center[0] + 0.01, center[1] - 0.005, center[2] + 0.4];
    let turn = [std::f64::consts::PI - 0.03, 0.02, 1.57];
    (
        Rgbd::d415(color, Place::default()),
        Place::from_rpy(position, turn),
    )
}

pub fn cell(order: Order, count: usize, seed: u64) -> Cell {
    let tray = Tray::default();
    let scene = tray.scene(order, count, seed);
    Cell::new(tray, scene, Gripper::default(), [0.0; 3])
}
