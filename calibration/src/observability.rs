//! Directions of the unknowns that the data determine, and a description of the others.

use super::error::Refusal;
use super::rows::Model;
use super::solve::Minimum;
use super::unknowns::State;
use nalgebra::{DMatrix, DVector, SymmetricEigen, Vector3};

/// Rank of the core unknowns (anchors, initial lengths, camera, bodies) without their priors.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Observability {
    /// Directions that the data determine.
    pub rank: usize,
    /// Number of core unknowns.
    pub unknowns: usize,
    /// The others in words: harmless shifts of the frame.
    pub harmless: Vec<String>,
    /// The others in words: what measurements would be needed.
    pub harmful: Vec<String>,
}

/// Relative size below which a direction counts as undetermined.
/// Eigenvalues are squares: known 3000 times less well than the best direction.
const NOTHING: f64 = 1e-7;

/// Judges the estimate's information.
///
/// # Errors
/// [`Refusal::NotConverged`] if the information cannot be computed.
pub(crate) fn observability(
    model: &Model<'_>,
    anchor_sigma_m: f64,
    minimum: &Minimum,
) -> Result<Observability, Refusal> {
    let layout = &model.layout;
    let core = layout.core();
    let all = layout.len();
    let information = &minimum.reduced.information;
    // All other unknowns are marginalised, with their priors.
    let mut core_information = information.view((0, 0), (core, core)).into_owned();
    let cross = information.view((0, core), (core, all - core)).into_owned();
    let rest = information
        .view((core, core), (all - core, all - core))
        .into_owned();
    let rest = super::normal::Scaled::new(&rest).ok_or_else(|| Refusal::NotConverged {
        what: "the information of the estimate is not positive definite".to_owned(),
    })?;
    core_information -= &cross * rest.inverse() * cross.transpose();
    let prior = 1.0 / (anchor_sigma_m * anchor_sigma_m);
    for i in 0..layout.initial_length(0) {
        core_information[(i, i)] -= prior;
    }
    // 1 mm and 1 mrad count as equal here.
    let eigen = SymmetricEigen::new(core_information.clone() * 1e-6);
    let largest = eigen.eigenvalues.amax();
    let rank = eigen
        .eigenvalues
        .iter()
        .filter(|value| **value > NOTHING * largest)
        .count();
    let free: Vec<DVector<f64>> = (0..core)
        .filter(|&i| eigen.eigenvalues[i] <= NOTHING * largest)
        .map(|i| eigen.eigenvectors.column(i).into_owned())
        .collect();
    let mut out = Observability {
        rank,
        unknowns: core,
        harmless: Vec::new(),
        harmful: Vec::new(),
    };
    // The part of a known shift of the frame that lies in the free directions.
    let within = |shift: &DVector<f64>| {
        free.iter().map(|v| v.dot(shift).powi(2)).sum::<f64>() / shift.norm_squared()
    };
    let mut explained: Vec<DVector<f64>> = Vec::new();
    for (words, shift) in frame_shifts(model, &minimum.state) {
        if within(&shift) > 0.99 {
            out.harmless.push(format!(
                "the frame can {words}: harmless, the anchors' prior places it"
            ));
            explained.push(shift);
        }
    }
    let basis = if explained.is_empty() {
        DMatrix::zeros(core, 0)
    } else {
        DMatrix::from_columns(&explained).qr().q()
    };
    for v in &free {
        let rest = v - &basis * (basis.transpose() * v);
        // More than a quarter of the direction (0.5 squared) is not a motion of the whole frame.
        if rest.norm() > 0.5 {
            out.harmful.push(name_of(model, rest.iamax()));
        }
    }
    out.harmful.dedup();
    Ok(out)
}

/// Displacements of the whole world frame, in core unknowns.
fn frame_shifts(model: &Model<'_>, state: &State) -> Vec<(&'static str, DVector<f64>)> {
    let layout = &model.layout;
    let words = [
        "shift in x",
        "shift in y",
        "shift in z",
        "turn about x",
        "turn about y",
        "turn about z",
    ];
    words
        .into_iter()
        .enumerate()
        .map(|(i, words)| {
            // Initial lengths and the camera's mounting do not change with the frame: they stay
            // zero.
            let mut v = DVector::zeros(layout.core());
            let axis = Vector3::from_fn(|k, _| if k == i % 3 { 1.0 } else { 0.0 });
            let turn = i >= 3;
            let at = |p: &Vector3<f64>| if turn { axis.cross(p) } else { axis };
            for (c, cable) in state.cables.iter().enumerate() {
                v.rows_mut(layout.anchor(c), 3)
                    .copy_from(&at(&cable.anchor_m));
            }
            for (b, body) in state.world_from_body.iter().enumerate() {
                v.rows_mut(layout.body(b), 3)
                    .copy_from(&at(&body.position_m));
                if turn {
                    v.rows_mut(layout.body(b) + 3, 3).copy_from(&axis);
                }
            }
            (words, v)
        })
        .collect()
}

fn name_of(model: &Model<'_>, index: usize) -> String {
    let layout = &model.layout;
    let axis = |i: usize| ["x", "y", "z"][i % 3];
    if index < layout.initial_length(0) {
        format!("cable {}'s anchor in {}", index / 3 + 1, axis(index))
    } else if index < layout.camera() {
        format!(
            "cable {}'s initial length",
            index - layout.initial_length(0) + 1
        )
    } else if index < layout.body(0) {
        place("the camera on the platform", index - layout.camera())
    } else {
        let i = index - layout.body(0);
        place(&format!("the tags of body {}", i / 6), i % 6)
    }
}

fn place(what: &str, i: usize) -> String {
    let axis = ["x", "y", "z"][i % 3];
    if i < 3 {
        format!("{what} in {axis}")
    } else {
        format!("{what} about {axis}")
    }
}
