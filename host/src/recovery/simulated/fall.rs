//! The platform's fall after a cut, and a person who moves it.

use super::SETTLE_US;
use crate::link::{ClientError, Link as _, SimulatedLink, plant_failed};
use crate::motion::Model;
use crate::run::RunError;
use crate::scenario::FaultyLink;
use mcdpr_simulator::TracePoint;
use nalgebra::Vector3;

/// The fall ends within this time after the cut, s.
const DROP_S: f64 = 0.6;

/// How far the tool fell below its planned motion, m, and its speed at the cut, m/s. The planned motion
/// continues at the speed of the cut until the slowest brake of the file has closed.
pub(super) fn fallen(trace: &[TracePoint], cut_s: f64, model: &Model) -> (f64, f64) {
    let after = trace.partition_point(|point| point.truth.time_s < cut_s);
    let Some(first) = trace.get(after) else {
        return (0.0, 0.0);
    };
    let brakes = model
        .robot()
        .winches
        .iter()
        .map(|winch| winch.brake_close_s);
    let close_s = brakes.fold(0.0, f64::max);
    let speed = Vector3::from(first.truth.velocity_mps).norm();
    let from_m = first.truth.tool_position_m[2];
    // Only a tool on its way down has a planned part of its fall.
    let way_m = first.truth.velocity_mps[2].min(0.0) * close_s;
    let rest = trace.get(after..).unwrap_or_default();
    let soon = rest
        .iter()
        .take_while(|point| point.truth.time_s < cut_s + DROP_S);
    let lowest_m = soon
        .map(|point| point.truth.tool_position_m[2])
        .fold(from_m, f64::min);
    ((from_m + way_m - lowest_m).max(0.0), speed)
}

/// A person carries the platform away and turns the drums after it.
pub(super) fn moved(
    model: &Model,
    link: &SimulatedLink,
    by_m: Vector3<f64>,
) -> Result<(), RunError> {
    let plant = |error| RunError::Client(ClientError::from(plant_failed(error)));
    let truth = link
        .with(|simulation| simulation.plant().truth())
        .map_err(plant)?;
    let from_m = Vector3::from(truth.tool_position_m);
    let (from, to) = (
        model.rest(&from_m, None)?,
        model.rest(&(from_m + by_m), None)?,
    );
    let longer: Vec<f64> = to
        .paid_out_m
        .iter()
        .zip(&from.paid_out_m)
        .map(|(to, from)| to - from)
        .collect();
    // 50 x 20 ms: a second, as a person carries it.
    let steps = 50;
    let mut line = link.clone();
    let mut unread = Vec::new();
    for _ in 0..steps {
        for (cable, way_m) in longer.iter().enumerate() {
            link.with(|s| s.plant_mut().slip_cable(cable, way_m / f64::from(steps)))
                .map_err(plant)?;
        }
        let until_us = line.now_us() + 20_000;
        while line.now_us() < until_us {
            line.receive(until_us, &mut unread)
                .map_err(ClientError::from)?;
        }
    }
    FaultyLink::new(link.clone(), &[])
        .settle(SETTLE_US)
        .map_err(ClientError::from)?;
    Ok(())
}
