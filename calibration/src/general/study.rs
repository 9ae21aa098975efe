//! Accuracy of predicted readings that the estimate has not used.

use super::data::Set;
use super::first::{first_pose, pose_of};
use super::fit::{Fit, Options, fit};
use super::model::Group;
use super::predict::{Answer, CHI2_3_95, Given, Score, predict, score};
use super::simulate::{Case, simulate};
use super::verdict::{Verdict, verdict, without_moving};
use nalgebra::Matrix3;
use serde::Serialize;

/// One of this many samples of the session is left out.
pub const EVERY: usize = 3;

/// Errors of predictions by sensor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Errors {
    /// Lengths, root mean square, mm.
    pub length_mm: Option<f64>,
    /// Roll and pitch, root mean square, degrees.
    pub tilt_deg: Option<f64>,
    /// Tensions, root mean square, N.
    pub tension_n: Option<f64>,
    /// Swivel angles, root mean square, degrees.
    pub swivel_deg: Option<f64>,
    /// Shares within the 95 % interval.
    pub inside: Inside,
    /// Number of samples.
    pub samples: usize,
}

/// Shares of the readings within their 95 % interval, by sensor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Inside {
    /// Of the lengths.
    pub length_mm: Option<f64>,
    /// Of roll and pitch.
    pub tilt_deg: Option<f64>,
    /// Of the tensions.
    pub tension_n: Option<f64>,
    /// Of the swivel angles.
    pub swivel_deg: Option<f64>,
}

impl Errors {
    /// Over some answers.
    #[must_use]
    pub fn of(answers: &[Answer]) -> Self {
        let of = |group: Group| score(answers, group, group.unit().factor);
        let (length, tilt) = (of(Group::Length), of(Group::Tilt));
        let (tension, swivel) = (of(Group::Tension), of(Group::Swivel));
        let rms = |s: Option<Score>| s.map(|s| s.rms);
        let inside = |s: Option<Score>| s.map(|s| s.inside);
        Self {
            length_mm: rms(length),
            tilt_deg: rms(tilt),
            tension_n: rms(tension),
            swivel_deg: rms(swivel),
            inside: Inside {
                length_mm: inside(length),
                tilt_deg: inside(tilt),
                tension_n: inside(tension),
                swivel_deg: inside(swivel),
            },
            samples: answers.len(),
        }
    }
}

/// The first pose of a session from changes only, compared with the estimate from all data.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FirstPose {
    /// The session.
    pub session: String,
    /// Number of its samples.
    pub samples: usize,
    /// Distance, mm.
    pub position_mm: f64,
    /// Angle between both attitudes, degrees.
    pub angle_deg: f64,
    /// Standard deviation of the position as stated, mm.
    pub stated_mm: f64,
}

/// Errors at the samples of one session.
#[derive(Debug, Clone)]
pub struct SessionErrors {
    /// The session's name.
    pub name: String,
    /// The errors.
    pub errors: Errors,
}

/// The whole result.
#[derive(Debug, Clone)]
pub struct Study {
    /// Every third sample of the session.
    pub held_out: Errors,
    /// All samples of the other sessions; `None` without one.
    pub other_sessions: Option<Errors>,
    /// The same by session.
    pub by_session: Vec<SessionErrors>,
    /// The first poses.
    pub first_poses: Vec<FirstPose>,
    /// The estimate.
    pub fit: Fit,
    /// Its verdict.
    pub verdict: Verdict,
    /// Notes on what was left out, and on samples that could not be predicted.
    pub notes: Vec<String>,
}

/// The readings that are given for a prediction: all lengths but the last cable's, and that cable's
/// tension. They determine pose and tensions; two lengths and two tensions hardly do.
#[must_use]
pub fn given(cables: usize) -> Vec<Given> {
    let last = cables.saturating_sub(1);
    let lengths = (0..last).map(|index| Given {
        group: Group::Length,
        index,
    });
    let tension = Given {
        group: Group::Tension,
        index: last,
    };
    lengths.chain([tension]).collect()
}

/// Estimates from two thirds of one session and predicts the rest and the other sessions.
///
/// # Errors
/// In words: an unknown session, too few samples, or data that do not fit any robot.
pub fn study(set: &Set, train: &str, options: &Options) -> Result<Study, String> {
    let session = set.session(train).ok_or_else(|| {
        let known = set.sessions.join(", ");
        format!("there is no session {train} in the data; there are {known}")
    })?;
    let mut place = 0;
    let left_out: Vec<bool> = set
        .samples
        .iter()
        .map(|sample| {
            // Counted within the session, so that every part of it is represented.
            place += usize::from(sample.session == session);
            sample.session == session && place % EVERY == 0
        })
        .collect();
    let seen = without_moving(&set.only(|k, sample| sample.session == session && !left_out[k]));
    if seen.samples.len() < 4 {
        return Err(format!(
            "{} samples of {train} are left to learn from, at least 4 are needed",
            seen.samples.len()
        ));
    }
    let found = fit(&seen, options)?;
    let verdict = verdict(&found);
    let mut notes = seen.notes.clone();
    let given = given(set.cable_count());
    let mut errors = |part: &Set| {
        let mut answers = Vec::new();
        for answer in predict(&found, part, &given, &options.priors) {
            match answer {
                Ok(answer) => answers.push(answer),
                Err(reason) => notes.push(reason),
            }
        }
        Errors::of(&answers)
    };
    let held_out = errors(&set.only(|k, _| left_out[k]));
    let others = set.only(|_, sample| sample.session != session);
    let other_sessions = (!others.samples.is_empty()).then(|| errors(&others));
    let mut by_session = Vec::new();
    for (index, name) in set.sessions.iter().enumerate() {
        let part = set.only(|_, sample| sample.session == index && index != session);
        if !part.samples.is_empty() {
            by_session.push(SessionErrors {
                name: name.clone(),
                errors: errors(&part),
            });
        }
    }
    Ok(Study {
        first_poses: first_poses(set, options)?,
        held_out,
        other_sessions,
        by_session,
        fit: found,
        verdict,
        notes,
    })
}

/// How well a simulated robot knows its place in a session that its calibration has not seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Region {
    /// Position error, root mean square, m.
    pub rms_m: f64,
    /// The same as stated, m.
    pub stated_m: f64,
    /// Share of the samples whose true position lies within the stated 95 % region.
    pub inside: f64,
}

/// Calibrates a simulated robot by its first session and predicts the poses of the second from three lengths and a
/// tension, in the frame of the anchors.
///
/// # Errors
/// In words: data that do not determine a robot.
pub fn region(case: &Case) -> Result<Region, String> {
    let (set, truth) = simulate(case).ok_or("the simulation has no robot")?;
    let options = Options::default();
    let found = fit(&set.only(|_, sample| sample.session == 0), &options)?;
    let rest = set.only(|_, sample| sample.session != 0);
    let places = set.samples.iter().zip(&truth.poses);
    let places = places.filter_map(|(sample, pose)| (sample.session != 0).then_some(pose));
    let (mut squares, mut stated, mut inside, mut count) = (0.0, 0.0, 0.0, 0.0);
    for (answer, pose) in predict(&found, &rest, &given(set.cable_count()), &options.priors)
        .into_iter()
        .zip(places)
    {
        let answer = answer?;
        let off = answer.pose.position_m - pose.position_m;
        let covariance: Matrix3<f64> = answer.pose_covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let weighed = covariance.cholesky().map(|c| off.dot(&c.solve(&off)));
        inside += f64::from(u8::from(weighed.is_some_and(|w| w <= CHI2_3_95)));
        squares += off.norm_squared();
        stated += covariance.trace();
        count += 1.0;
    }
    Ok(Region {
        rms_m: (squares / count).sqrt(),
        stated_m: (stated / count).sqrt(),
        inside: inside / count,
    })
}

fn first_poses(set: &Set, options: &Options) -> Result<Vec<FirstPose>, String> {
    // The reference: an estimate from all sessions.
    let all = fit(set, options)?;
    let mut out = Vec::new();
    for (index, session) in set.sessions.iter().enumerate() {
        let part = set.only(|_, sample| sample.session == index);
        let known = set
            .samples
            .iter()
            .position(|sample| sample.session == index);
        let Some(known) = known.and_then(|k| pose_of(&all, k)) else {
            continue;
        };
        let first = first_pose(&part)?;
        let place = first.covariance.fixed_view::<3, 3>(0, 0);
        out.push(FirstPose {
            session: session.clone(),
            samples: part.samples.len(),
            position_mm: (first.pose.position_m - known.pose.position_m).norm() * 1e3,
            angle_deg: first
                .pose
                .rotation
                .angle_to(&known.pose.rotation)
                .to_degrees(),
            stated_mm: place.trace().sqrt() * 1e3,
        });
    }
    Ok(out)
}
