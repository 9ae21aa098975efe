//! Why work on a winch fails.

use crate::link::ClientError;
use crate::machine::OutOfRange;
use crate::run::RunError;
use miette::Diagnostic;
use thiserror::Error;

/// Why work on a winch failed.
#[derive(Debug, Error, Diagnostic)]
pub enum ServiceError {
    /// The board, a fault, an interrupt.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Run(#[from] RunError),
    /// The robot has no such winch.
    #[error("the robot has no winch {winch}: it has 1 to {count}")]
    #[diagnostic(
        code(mcdpr::service::winch),
        help("winches are numbered as the cables of the robot file, from 1")
    )]
    NoWinch {
        /// Asked for.
        winch: usize,
        /// There are.
        count: usize,
    },
    /// No drive answers on the bus.
    #[error("no drive answers on the bus at {bitrate} bit/s")]
    #[diagnostic(
        code(mcdpr::service::silent),
        help(
            "check the drive's supply, CAN-H and CAN-L (not swapped), 120 ohm at both ends, and `bitrate` in [bus]; docs/wiring.md shows the bus"
        )
    )]
    NoDrive {
        /// The bus's bit rate.
        bitrate: u32,
    },
    /// Several drives are possible.
    #[error(
        "drives {found} answer, and none of them is number {expected}, which the robot file gives winch {winch}"
    )]
    #[diagnostic(
        code(mcdpr::service::ambiguous),
        help("connect this winch's drive alone, or say which it is with `--node N`")
    )]
    Ambiguous {
        /// The winch.
        winch: usize,
        /// The file's number.
        expected: u8,
        /// Those that answer and that no other winch claims.
        found: String,
    },
    /// The tension sensor's reading is not that of a bare winch.
    #[error(
        "the tension sensor of winch {winch} reads {volts:.3} V, {newtons:.1} N by the robot file: not a bare winch"
    )]
    #[diagnostic(
        code(mcdpr::service::loaded),
        help(
            "take the cable off the sensor; a reading near 0 V or 3.3 V is a broken wire or a missing supply of the amplifier (docs/wiring.md)"
        )
    )]
    Loaded {
        /// The winch.
        winch: usize,
        /// Read.
        volts: f64,
        /// By the file's gain and zero.
        newtons: f64,
    },
    /// The motor did not turn.
    #[error("the motor of winch {winch} turned {moved} counts of {asked}")]
    #[diagnostic(
        code(mcdpr::service::motor),
        help(
            "the brake did not open, or something blocks the drum: listen for the brake's click and check its 24 V driver (docs/wiring.md)"
        )
    )]
    MotorStuck {
        /// The winch.
        winch: usize,
        /// Counts that it turned.
        moved: i64,
        /// Counts that it should have turned.
        asked: i64,
    },
    /// The drum encoder did not count.
    #[error(
        "the drum encoder of winch {winch} counted {counted} while its motor turned {motor} counts"
    )]
    #[diagnostic(
        code(mcdpr::service::encoder),
        help(
            "check the encoder's 5 V, its A and B wires and the coupling to the drum (docs/wiring.md); nothing was written"
        )
    )]
    EncoderStuck {
        /// The winch.
        winch: usize,
        /// Drum encoder counts.
        counted: i64,
        /// Motor counts.
        motor: i64,
    },
    /// The brake slipped.
    #[error(
        "the closed brake of winch {winch} let the drum turn by {counted} encoder counts at {current_a:.2} A"
    )]
    #[diagnostic(
        code(mcdpr::service::brake),
        help(
            "a brake must hold without current: check that its coil is wired to open it, its spring, and its air gap"
        )
    )]
    BrakeSlips {
        /// The winch.
        winch: usize,
        /// Drum encoder counts.
        counted: i64,
        /// Current at which it did, A.
        current_a: f64,
    },
    /// The drive gave no current against the brake, so that the brake is not tested.
    #[error(
        "the drive of winch {winch} gave {current_a:.3} A of {asked_a:.3} A against the closed brake"
    )]
    #[diagnostic(
        code(mcdpr::service::current),
        help("check the motor's three phases and the drive's supply")
    )]
    NoCurrent {
        /// The winch.
        winch: usize,
        /// Measured, A.
        current_a: f64,
        /// Asked for, A.
        asked_a: f64,
    },
    /// The measurements are inconsistent with a friction.
    #[error(
        "the friction of winch {winch} is {friction_mnm:.3} mN m at the motor, give or take {error_mnm:.3}: the currents of both directions contradict each other"
    )]
    #[diagnostic(
        code(mcdpr::service::friction),
        help(
            "something catches on the drum, or its feedback of current is dead: turn it by hand, without a cable, and commission it again"
        )
    )]
    Rubs {
        /// The winch.
        winch: usize,
        /// Friction, mN m.
        friction_mnm: f64,
        /// Its standard error, mN m.
        error_mnm: f64,
    },
    /// The weight is too heavy for the winch or its sensor.
    #[error(
        "{weight_n:.1} N on winch {winch} need {needed_a:.2} A of {most_a:.2} A, and its sensor measures {most_n:.1} N"
    )]
    #[diagnostic(
        code(mcdpr::service::heavy),
        help("take a lighter weight: `--weight-kg` with half of it")
    )]
    TooHeavy {
        /// The winch.
        winch: usize,
        /// The weight, N.
        weight_n: f64,
        /// Current that it may need, A.
        needed_a: f64,
        /// Most of the motor's current, A.
        most_a: f64,
        /// Most that the sensor measures, N.
        most_n: f64,
    },
    /// The sensor does not show the weight.
    #[error(
        "the tension sensor of winch {winch} reads {sensor_n:.2} N of the {weight_n:.2} N that hang on it"
    )]
    #[diagnostic(
        code(mcdpr::service::hung),
        help(
            "hang the weight on a cable that runs from the drum over the sensor, with a quarter of a turn on the drum; check `tension_gain_n_per_v` (`mcdpr calibrate tension`)"
        )
    )]
    NotHung {
        /// The winch.
        winch: usize,
        /// The weight, N.
        weight_n: f64,
        /// Read, N.
        sensor_n: f64,
    },
    /// No gear has this loss.
    #[error(
        "the gear of winch {winch} would have an efficiency of {:.1} % (standard error {:.1}) and of {:.1} % (standard error {:.1}) when driven: no gear behaves so",
        efficiency * 100.0, efficiency_se * 100.0, backdrive * 100.0, backdrive_se * 100.0
    )]
    #[diagnostic(
        code(mcdpr::service::loss),
        help(
            "check `torque_constant_nm_per_a`, `drum_radius_mm`, `gear_ratio` and the weight; it must hang freely all the time"
        )
    )]
    Loses {
        /// The winch.
        winch: usize,
        /// Share of the motor's power that reaches the drum.
        efficiency: f64,
        /// Its standard error.
        efficiency_se: f64,
        /// Share of the drum's power that reaches the motor.
        backdrive: f64,
        /// Its standard error.
        backdrive_se: f64,
    },
    /// The operator did not answer.
    #[error("no answer was given about the drum of winch {winch}")]
    #[diagnostic(
        code(mcdpr::service::nobody),
        help(
            "watch the drum and answer, or run again with `--paid-out yes` or `--paid-out no`; a weight needs an answer at a terminal or on the page"
        )
    )]
    NoAnswer {
        /// The winch.
        winch: usize,
    },
}

impl From<ClientError> for ServiceError {
    fn from(error: ClientError) -> Self {
        Self::Run(error.into())
    }
}

impl From<OutOfRange> for ServiceError {
    fn from(error: OutOfRange) -> Self {
        Self::Run(error.into())
    }
}
