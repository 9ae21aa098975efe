//! What a tag's corner in a picture says about pose, camera and tag: the rows of both estimators.

use mcdpr_kinematics::{Error, Pose};
use mcdpr_vision::{Camera, Projection};
use nalgebra::{Matrix3, Vector3};

/// A corner as a camera on the platform sees it.
pub(crate) struct Corner<'a> {
    /// Pixel, and its derivatives by the camera's parameters.
    pub(crate) seen: Projection,
    /// From the body's origin to the corner without the tag's scale, world axes, m.
    pub(crate) arm: Vector3<f64>,
    camera_from_world: &'a Matrix3<f64>,
    /// The same with the scale, m.
    on_body: Vector3<f64>,
    /// From the platform's origin, world axes, m.
    from_platform: Vector3<f64>,
    /// The same, camera axes, m.
    turned: Vector3<f64>,
}

/// Indices of the first unknowns of the camera's mounting and of the tag's body.
pub(crate) struct Places {
    pub(crate) camera: usize,
    pub(crate) body: usize,
}

/// Estimated places of the platform, of its camera and of the tag's body.
#[derive(Clone, Copy)]
pub(crate) struct Poses<'a> {
    pub(crate) world_from_platform: &'a Pose,
    pub(crate) camera_from_platform: &'a Pose,
    pub(crate) world_from_body: &'a Pose,
}

impl<'a> Corner<'a> {
    /// Projects a corner (in its body, m) of a tag whose size is `scale` times the nominal one;
    /// `camera_from_world` is the rotation that belongs to `poses`.
    ///
    /// # Errors
    /// [`Error::InvalidInput`] where the corner is behind the camera.
    pub(crate) fn new(
        camera: &Camera,
        camera_from_world: &'a Matrix3<f64>,
        poses: Poses<'_>,
        corner_in_body_m: &Vector3<f64>,
        scale: f64,
    ) -> Result<Self, Error> {
        let body = poses.world_from_body;
        let arm = body.rotation * corner_in_body_m;
        let on_body = arm * scale;
        let from_platform = body.position_m + on_body - poses.world_from_platform.position_m;
        let turned = camera_from_world * from_platform;
        let point = turned + poses.camera_from_platform.position_m;
        let seen = camera
            .projection(&point.into())
            .ok_or(Error::InvalidInput {
                what: "a tag's corner is behind the camera",
                cable: None,
                value: point.z,
            })?;
        Ok(Self {
            seen,
            arm,
            camera_from_world,
            on_body,
            from_platform,
            turned,
        })
    }

    /// Derivatives of pixel coordinate `axis` times `weight` by the platform's displacement (into
    /// `own`), and by those of camera and body (into `shared`, which is emptied first). Gives the
    /// derivative by the corner's place, world axes.
    pub(crate) fn derivatives(
        &self,
        axis: usize,
        weight: f64,
        own: &mut [f64],
        shared: &mut Vec<Entry>,
        at: &Places,
    ) -> Vector3<f64> {
        let by_point = self.seen.by_point.row(axis).transpose() * weight;
        let by_world = self.camera_from_world.tr_mul(&by_point);
        put(own, 0, &-by_world);
        // d(R^T v) = R^T (v x phi): the row is (by_world x v).
        put(own, 3, &by_world.cross(&self.from_platform));
        shared.clear();
        let (camera, body) = (self.turned.cross(&by_point), self.on_body.cross(&by_world));
        // At once: there are thousands of rows.
        let all = [
            (at.camera, by_point),
            (at.camera + 3, camera),
            (at.body, by_world),
            (at.body + 3, body),
        ];
        let entry = |i: usize| Entry::new(all[i / 3].0 + i % 3, all[i / 3].1[i % 3]);
        shared.extend::<[Entry; 12]>(std::array::from_fn(entry));
        by_world
    }
}

/// Writes a vector into a dense row.
pub(crate) fn put(own: &mut [f64], at: usize, v: &Vector3<f64>) {
    own[at..at + 3].copy_from_slice(v.as_slice());
}

/// An entry of a sparse row: the derivative with respect to one unknown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Entry {
    /// Index of the unknown.
    pub at: usize,
    /// The derivative.
    pub slope: f64,
}

impl Entry {
    pub(crate) const fn new(at: usize, slope: f64) -> Self {
        Self { at, slope }
    }
}

/// Adds a vector to a sparse row.
pub(crate) fn spread(shared: &mut Vec<Entry>, at: usize, v: &Vector3<f64>) {
    for k in 0..3 {
        shared.push(Entry::new(at + k, v[k]));
    }
}
