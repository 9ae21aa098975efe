//! The keys of a winch.

use super::{key, non_negative, positive};
use crate::robot::schema::Absent::{Follows, Whole, Word};
use crate::robot::schema::Range::{Finite, Within};
use crate::robot::schema::{Absent, Kind, Section};

/// `[[winch]]`, and a winch module file (without `module`, `id` and `node`).
pub(crate) static WINCH: Section = Section {
    title: "[[winch]]",
    keys: &[
        key(
            "module",
            Kind::Text,
            Follows("no module file"),
            "winch module file, relative to this file's folder; keys written here override it",
        ),
        key(
            "id",
            Kind::Whole(1, 255),
            Follows("its place in the file, from 1"),
            "number of the winch, which `[[cable]] winch` names",
        ),
        positive(
            "drum_radius_mm",
            20.0,
            "drum radius to the cable's centre, mm",
        ),
        positive(
            "cable_diameter_mm",
            1.0,
            "cable diameter, the least pitch of the turns on the drum, mm",
        ),
        positive(
            "turns_max",
            12.0,
            "turns of cable that the drum takes in one layer",
        ),
        non_negative(
            "drum_inertia_kg_m2",
            4e-5,
            "inertia of the drum, screw and coupling about the drum's axis, kg m2",
        ),
        key(
            "encoder_counts_per_turn",
            Kind::Whole(4, 16_777_216),
            Whole(4096),
            "drum encoder counts per drum turn, all four edges",
        ),
        key(
            "encoder_sign",
            Kind::Whole(-1, 1),
            Whole(1),
            "1 if the drum encoder counts up while cable is paid out, -1 otherwise",
        ),
        key(
            "motor_counts_per_turn",
            Kind::Number(Finite),
            Follows("gear_ratio x 4096, rounded"),
            "motor encoder counts per DRUM turn; negative where they fall as cable is paid out",
        ),
        positive("gear_ratio", 371.13, "motor turns per drum turn"),
        positive(
            "max_motor_rpm",
            8000.0,
            "greatest motor speed, turns per minute",
        ),
        positive("max_current_a", 0.5, "greatest motor current, A"),
        positive(
            "torque_constant_nm_per_a",
            0.006,
            "motor torque per current, Nm/A",
        ),
        non_negative(
            "rotor_inertia_kg_m2",
            1e-7,
            "inertia of the motor's rotor about its own axis, kg m2",
        ),
        non_negative(
            "friction_n",
            0.5,
            "Coulomb friction of drum, screw and bearings, felt at the cable, N; of the whole winch where no other friction is named",
        ),
        non_negative(
            "rotor_friction_mnm",
            0.0,
            "Coulomb friction of the motor's rotor: bearings, brushes, mN m at the motor",
        ),
        non_negative(
            "gear_friction_mnm",
            0.0,
            "Coulomb friction of the gear without load, mN m at the motor",
        ),
        key(
            "static_friction",
            Kind::Number(Within(1.0, 5.0)),
            Absent::Number(1.0),
            "friction of rotor and gear at rest over their Coulomb friction, 1 to 5",
        ),
        positive(
            "stribeck_rpm",
            100.0,
            "motor speed over which friction falls from rest to Coulomb friction, rpm",
        ),
        non_negative(
            "viscous_mnm_per_krpm",
            0.0,
            "viscous friction of rotor and gear, mN m at the motor per 1000 rpm",
        ),
        key(
            "gear_efficiency",
            Kind::Number(Within(0.01, 1.0)),
            Absent::Number(1.0),
            "share of the motor's power that reaches the drum, without the friction above",
        ),
        key(
            "backdrive_efficiency",
            Kind::Number(Within(0.0, 1.0)),
            Follows("2 - 1 / gear_efficiency, or 0 where that is less"),
            "share of the drum's power that reaches the motor; 0 locks itself",
        ),
        key(
            "play_deg",
            Kind::Number(Within(0.0, 10.0)),
            Absent::Number(0.0),
            "play between motor and drum, as a turn of the drum, degrees",
        ),
        non_negative(
            "torsional_stiffness_nm_per_rad",
            0.0,
            "torque per twist between motor and drum, at the drum, N m/rad; 0: rigid, which takes no friction, loss or play of a gear",
        ),
        non_negative(
            "cogging_mnm",
            0.0,
            "cogging torque of the motor, amplitude, mN m",
        ),
        key(
            "cogging_per_turn",
            Kind::Whole(1, 1000),
            Absent::Whole(12),
            "periods of the cogging torque per turn of the motor: the least common multiple of its slots and poles",
        ),
        key(
            "cold_friction",
            Kind::Number(Within(1.0, 10.0)),
            Absent::Number(1.0),
            "friction of rotor and gear when they are cold over that when warm, 1 to 10; it warms up within 300 s of turning",
        ),
        non_negative(
            "drum_eccentricity_mm",
            0.0,
            "how far the drum is out of its axis, mm",
        ),
        positive(
            "brake_close_ms",
            30.0,
            "time from the command until the brake holds, ms",
        ),
        positive(
            "brake_holding_n",
            150.0,
            "force at the cable that the closed brake holds, N; plans end only where the brake's test, with 1.69 times each tension, passes",
        ),
        key(
            "drive_hold_up_ms",
            Kind::Number(Within(0.0, 1000.0)),
            Absent::Number(0.0),
            "time for which the rail keeps the drive after its supply failed, ms; the brakes, fed before the rail's diode, lose theirs at once",
        ),
        key(
            "brake_play_deg",
            Kind::Number(Within(0.0, 2.0)),
            Absent::Number(0.0),
            "how far the drum turns in its closed brake, degrees; `mcdpr commission` measures it",
        ),
        positive(
            "tension_gain_n_per_v",
            12.77,
            "k of tension = k (voltage - u_0), N/V",
        ),
        key(
            "tension_zero_v",
            Kind::Number(Within(0.0, 3.3)),
            Absent::Number(0.2355),
            "u_0 of tension = k (voltage - u_0), V",
        ),
        positive(
            "tension_max_n",
            39.13,
            "full scale of the tension sensor, N",
        ),
        key(
            "drive",
            Kind::Word(&["rmds", "cia402"]),
            Word("rmds"),
            "protocol of the motor drive",
        ),
        key(
            "node",
            Kind::Whole(1, 126),
            Follows("the winch's id"),
            "number of the drive on the bus; rmds takes 1 to 15, cia402 1 to 126",
        ),
        positive(
            "drive_bandwidth_rad_s",
            150.0,
            "bandwidth of the drive's position loop, rad/s",
        ),
        non_negative(
            "current_lag_ms",
            3.0,
            "time constant of the drive's current loop, ms",
        ),
    ],
};
