//! What commissioning found otherwise than the robot file says.

use super::Commissioned;
use super::commission::BRAKE_GIVES;
use crate::robot::Winch;

/// Differences in words, each with both values.
pub(super) fn differences(found: &Commissioned, described: &Winch) -> Vec<String> {
    let mut words = Vec::new();
    let mut note = |is: bool, name: &str, file: String, here: String| {
        if is {
            words.push(format!("{name}: the robot file says {file}, it is {here}"));
        }
    };
    note(
        found.node != described.node,
        "node",
        described.node.to_string(),
        found.node.to_string(),
    );
    note(
        found.encoder_sign != described.encoder_sign,
        "encoder_sign",
        described.encoder_sign.to_string(),
        found.encoder_sign.to_string(),
    );
    note(
        (found.motor_counts_per_turn - described.motor_counts_per_turn).abs() > 0.5,
        "motor_counts_per_turn",
        described.motor_counts_per_turn.to_string(),
        found.motor_counts_per_turn.to_string(),
    );
    note(
        (found.tension_zero_v - described.tension_zero_v).abs() > 0.002,
        "tension_zero_v",
        described.tension_zero_v.to_string(),
        found.tension_zero_v.to_string(),
    );
    let file_deg = (described.brake_play_m / described.drum_radius_m).to_degrees();
    note(
        (found.brake_play_deg - file_deg).abs() > brake_play_unsure_deg(described),
        "brake_play_deg",
        format!("{file_deg:.2}"),
        format!("{:.2}", found.brake_play_deg),
    );
    if let (Some(loss), Some(gear)) = (&found.loss, &described.gear) {
        for (name, file, here) in [
            ("gear_efficiency", gear.efficiency, loss.efficiency),
            (
                "backdrive_efficiency",
                gear.backdrive_efficiency,
                loss.backdrive_efficiency,
            ),
        ] {
            let both = (format!("{file:.2}"), format!("{here:.2}"));
            note((here - file).abs() > 0.05, name, both.0, both.1);
        }
    }
    let Some(rubs) = &found.rubbing else {
        return words;
    };
    if let Some(friction) = &rubs.friction {
        let file_n = described.total_friction_n();
        // With the friction known to a quarter a board reels in and tests brakes correctly.
        note(
            (friction.friction_n - file_n).abs() > (0.25 * file_n).max(0.3),
            "friction at the cable",
            format!("{file_n:.2} N"),
            format!("{:.2} N", friction.friction_n),
        );
    }
    let file_deg = (described.play_m() / described.drum_radius_m).to_degrees();
    note(
        (rubs.play_deg - file_deg).abs() > 0.1,
        "play_deg",
        format!("{file_deg:.2}"),
        format!("{:.2}", rubs.play_deg),
    );
    words
}

/// Uncertainty of the brake's play: counts by which a closed brake yields by itself.
fn brake_play_unsure_deg(described: &Winch) -> f64 {
    360.0 * BRAKE_GIVES as f64 / f64::from(described.encoder_counts_per_turn)
}
