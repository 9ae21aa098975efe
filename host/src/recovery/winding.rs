//! The gentle test on a board: each winch alone winds its cable by some tenths of a millimetre, with the
//! brakes of all others closed, under the board's supervision ([`Request::Service`]).

use super::look;
use crate::link::{Client, Link};
use crate::machine;
use crate::motion::{Model, knot};
use crate::run::{self, RunError, wait_for};
use mcdpr_core::recovery::gentle::{LEAST_N, MOST_CHANGE_N, Response, WAY_M};
use mcdpr_core::recovery::looks::RestReadings;
use mcdpr_protocol::{
    BoardState, CableKey, CableKnot, ConfigKey, Knot, MicrometresPerSecond, Millinewtons, Request,
    StopKind, TenthMicrometres,
};

/// Knots of one way, and the time between them, ms: 0.3 s for 0.4 mm.
const KNOTS: u32 = 10;
const SPACING_MS: u32 = 30;
/// Time for a drive to settle after a way, µs.
const SETTLE_US: u64 = 500_000;

/// What a test gave.
pub(super) enum Tested {
    /// The response of every cable.
    Responses(Vec<Response>),
    /// It was not begun, or ended early: the reason.
    Refused(String),
}

/// Tests all cables. `lengths_m` are provisional: the board needs some to hold a drum. The robot hangs on its
/// brakes, disarmed, before and afterwards, and its drums are where they were.
///
/// # Errors
/// The client's; [`RunError::Fault`] where the board stops the test.
pub(super) fn test<L: Link>(
    client: &mut Client<L>,
    model: &Model,
    rest: &RestReadings,
    lengths_m: &[f64],
) -> Result<Tested, RunError> {
    let weakest = rest
        .tensions_n
        .iter()
        .copied()
        .fold(f64::INFINITY, f64::min);
    if weakest < LEAST_N {
        let reason = format!(
            "a cable has {weakest:.1} N only: winding could make it slack (a gentle test needs {LEAST_N:.0} N)"
        );
        return Ok(Tested::Refused(reason));
    }
    let mut responses = Vec::new();
    for cable in 0..lengths_m.len() {
        enable(client, model, rest, lengths_m, cable)?;
        let response = wind(client, model, rest, cable);
        if response.is_err() {
            // Whatever failed: its brake closes. The failure is reported, not this request's.
            let _ = client.stop(StopKind::Stop);
        }
        let response = response?;
        client.request(Request::Disarm)?;
        wait_for(client, BoardState::Disarmed, crate::run::PARKS_S)?;
        match response {
            Ok(response) => responses.push(response),
            Err(reason) => return Ok(Tested::Refused(reason)),
        }
    }
    Ok(Tested::Responses(responses))
}

/// Gives one winch torque and opens its brake.
fn enable<L: Link>(
    client: &mut Client<L>,
    model: &Model,
    rest: &RestReadings,
    lengths_m: &[f64],
    cable: usize,
) -> Result<(), RunError> {
    let number = u8::try_from(cable).unwrap_or(u8::MAX);
    let mut entries = machine::configuration(model.robot())?;
    // By its length, even if a motion holds it by tension: the test winds a known way.
    let control = ConfigKey::cable(number, CableKey::Control);
    if let Some(entry) = entries.iter_mut().find(|entry| entry.key == control) {
        entry.value = 0;
    }
    let config_hash = machine::hash_of(&entries);
    run::send_configuration(client, &entries, config_hash)?;
    client.request(machine::reference(lengths_m, &rest.tensions_n))?;
    client.request(Request::Service {
        config_hash,
        cable: number + 1,
        open: true,
    })?;
    wait_for(client, BoardState::Holding, 6.0)
}

/// Winds a cable and reads all tensions at both ends. Both are reached by taking in, so that friction of
/// pulleys acts the same way.
fn wind<L: Link>(
    client: &mut Client<L>,
    model: &Model,
    rest: &RestReadings,
    cable: usize,
) -> Result<Result<Response, String>, RunError> {
    let mut at_m = 0.0;
    // What the board commands, not what it measures: a closed brake with play lets a drum turn by a count.
    let setpoints = run::status(client)?.setpoints;
    let held: Vec<f64> = setpoints.iter().map(|length| length.metres()).collect();
    let mut ends = Vec::new();
    for (over_m, end_m) in [(2.0 * WAY_M, WAY_M), (-WAY_M, -WAY_M)] {
        for to_m in [over_m, end_m] {
            go(client, &held, cable, at_m, to_m)?;
            at_m = to_m;
        }
        let settled_us = client.now_us() + SETTLE_US;
        client.pump(settled_us)?;
        let looks = look(client, model, &mut None, &[])?;
        ends.push((looks.rest(model.robot()), motor_m(client, model, cable)?));
        let (read, _) = &ends[ends.len() - 1];
        let pairs = read.tensions_n.iter().zip(&rest.tensions_n);
        let most_n = pairs
            .map(|(now, then)| (now - then).abs())
            .fold(0.0, f64::max);
        if most_n > MOST_CHANGE_N {
            go(client, &held, cable, at_m, 0.0)?;
            return Ok(Err(format!(
                "winding cable {} by {:.1} mm changed a tension by {most_n:.1} N: something holds the platform or the cable",
                cable + 1,
                WAY_M * 1e3
            )));
        }
    }
    go(client, &held, cable, at_m, 0.0)?;
    let [(first, first_m), (second, second_m)] = &ends[..] else {
        return Ok(Err("the test has no two ends".to_owned()));
    };
    let both = |of: fn(&RestReadings) -> &[f64]| {
        let pairs = of(second).iter().zip(of(first));
        pairs.map(|(to, from)| (*to, *from)).collect::<Vec<_>>()
    };
    let changes = both(|end| &end.tensions_n);
    let errors = both(|end| &end.tension_errors_n);
    Ok(Ok(Response {
        cable,
        way_m: second_m - first_m,
        changes_n: changes.iter().map(|(to, from)| to - from).collect(),
        errors_n: errors.iter().map(|(to, from)| to.hypot(*from)).collect(),
    }))
}

/// What a motor has paid out since its drive started, m: finer than the drum's encoder.
fn motor_m<L: Link>(client: &mut Client<L>, model: &Model, cable: usize) -> Result<f64, RunError> {
    let number = u8::try_from(cable + 1).unwrap_or(u8::MAX);
    let counts = f64::from(client.winch(number)?.motor_counts);
    let winch = model.robot().winch_of(cable);
    Ok(winch.map_or(0.0, |winch| {
        counts / winch.motor_counts_per_turn * std::f64::consts::TAU * winch.drum_radius_m
    }))
}

/// Winds one cable from where it is to another place, relative to its length in `held_m`, and waits.
fn go<L: Link>(
    client: &mut Client<L>,
    held_m: &[f64],
    cable: usize,
    from_m: f64,
    to_m: f64,
) -> Result<(), RunError> {
    let time_s = f64::from(KNOTS * SPACING_MS) * 1e-3;
    client.request(Request::Discard)?;
    for number in 0..=KNOTS {
        let share = f64::from(number) / f64::from(KNOTS);
        // A quintic from rest to rest.
        let done = share.powi(3) * (10.0 - 15.0 * share + 6.0 * share * share);
        let slope = 30.0 * share * share * (1.0 - share).powi(2) / time_s;
        let cables = held_m.iter().enumerate().map(|(index, held_m)| {
            let way_m = if index == cable { to_m - from_m } else { 0.0 };
            let begun_m = if index == cable {
                held_m + from_m
            } else {
                *held_m
            };
            #[expect(clippy::cast_possible_truncation, reason = "some mm/s")]
            let velocity = MicrometresPerSecond((way_m * slope * 1e6).round() as i32);
            CableKnot {
                length: TenthMicrometres::from_metres(begun_m + way_m * done),
                velocity,
                tension: Millinewtons(0),
            }
        });
        let knot = Knot {
            last: number == KNOTS,
            ..knot::knot(number as usize, number * SPACING_MS, cables)
        };
        client.request(Request::Knot(knot))?;
    }
    client.request(Request::Start)?;
    wait_for(client, BoardState::Holding, time_s + 2.0)
}
