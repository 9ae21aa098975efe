//! What a picture of tags says of the camera's pose.

use super::lines::Lines;
use super::rows::{Rest, Rows, vector};
use mcdpr_kinematics::Pose;
use nalgebra::{Matrix3, Matrix6, Rotation3, SVector, Vector3};

impl Rest<'_> {
    /// Six rows that say what all corners of all tags say about the camera's pose.
    pub(super) fn camera_rows(
        &self,
        x: &[f64],
        pose: &Pose,
        with_states: bool,
        rows: &mut Rows,
    ) -> Option<()> {
        let camera = &self.robot.camera;
        let first = self.layout().camera();
        let unknowns = self.unknowns();
        let shift = vector(x, first);
        let turn = Rotation3::new(vector(x, first + 3));
        let mount = &camera.camera_from_platform;
        let mut corners = Lines::new(7);
        for view in &self.measured.views {
            let tag = self.robot.tags.iter().find(|tag| tag.id == view.id);
            let place = tag.and_then(|t| {
                self.measured
                    .places
                    .iter()
                    .find(|place| place.body == t.body)
            });
            let (Some(tag), Some(place)) = (tag, place) else {
                continue;
            };
            let seen = view.corners_px.iter().zip(&view.covariance_px2);
            for (corner, (seen, covariance)) in tag.corners_in_body_m.iter().zip(seen) {
                let in_world = place.world_from_body.transform(corner);
                let in_camera = mount.transform(&pose.inverse().transform(&in_world));
                let there = turn * in_camera + shift;
                let said = camera.lens.projection(&there.into())?;
                for (axis, seen) in seen.iter().enumerate() {
                    let sigma = covariance[axis][axis].max(1e-6).sqrt();
                    let by: Vector3<f64> = said.by_point.row(axis).transpose();
                    let turned = there.cross(&by);
                    let line = [by.x, by.y, by.z, turned.x, turned.y, turned.z];
                    let (_, row) = corners.push();
                    for (slot, value) in row.iter_mut().zip(line) {
                        *slot = value / sigma;
                    }
                    row[6] = ([said.pixel.x, said.pixel.y][axis] - seen) / sigma;
                }
            }
        }
        if corners.count() < 8 || !corners.triangulate(6) {
            return Some(());
        }
        // Twist of the camera frame by a twist of the platform (world, about its origin).
        let to_camera = turn.matrix() * mount.rotation.matrix();
        let back = pose.rotation.matrix().transpose();
        let rotate = to_camera * back;
        let origin = turn * mount.position_m + shift;
        let mut by_pose = Matrix6::zeros();
        by_pose.fixed_view_mut::<3, 3>(0, 0).copy_from(&-rotate);
        by_pose.fixed_view_mut::<3, 3>(3, 3).copy_from(&-rotate);
        // A turn about the platform's origin moves the camera's own: dX = -R (phi x (X_w - p)).
        let lever: Matrix3<f64> = origin.cross_matrix() * rotate;
        by_pose.fixed_view_mut::<3, 3>(0, 3).copy_from(&-lever);
        for corner in corners.iter().take(6) {
            let (index, row) = rows.lines.push();
            let slopes = SVector::<f64, 6>::from_column_slice(&corner[..6]);
            for (entry, column) in row.iter_mut().zip(by_pose.column_iter()) {
                *entry = slopes.dot(&column);
            }
            row[unknowns] = corner[6];
            if with_states {
                for (k, value) in corner.iter().take(6).enumerate() {
                    rows.put(index, first + k, *value);
                }
            }
        }
        Some(())
    }
}
