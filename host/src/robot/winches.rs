//! The winches of the file: module files, defaults, and the checks among winches.

use std::collections::BTreeMap;

use super::build::{MM_PER_M, MS_PER_S};
use super::model::{DriveKind, Winch};
use super::modules::Modules;
use super::read::{Reader, Values};
use super::schema::{self, key};

/// Supply of the tension sensor's converter, V: the board reads no voltage above it.
const SENSOR_SUPPLY_V: f64 = 3.3;

/// The winches of the file, or one of defaults per cable.
pub(super) fn winches(
    reader: &mut Reader,
    tables: Vec<Values>,
    modules: &Modules,
    cables: &[Values],
) -> Vec<Winch> {
    let mut winches = Vec::new();
    if tables.is_empty() {
        for cable in cables {
            let table = Values::absent(&schema::WINCH, "[[winch]]", cable.at(key!(CABLE, "winch")));
            let id = winches.len() as i64 + 1;
            // A robot without winch tables may name its default winches as it likes.
            winches.push(winch(
                &table,
                cable.whole_given(key!(CABLE, "winch")).unwrap_or(id),
            ));
        }
        return winches;
    }
    let mut ids: BTreeMap<u8, String> = BTreeMap::new();
    let mut nodes: BTreeMap<u8, String> = BTreeMap::new();
    for (index, mut table) in tables.into_iter().enumerate() {
        if table.has(key!(WINCH, "module"))
            && let Some(module) = read_module(reader, &table, modules)
        {
            table.fill_from(module);
        }
        let place = table.place.clone();
        if table.whole_given(key!(WINCH, "encoder_sign")) == Some(0) {
            reader.problem(
                &table.at(key!(WINCH, "encoder_sign")),
                &place,
                "`encoder_sign` must be 1 or -1, not 0".into(),
                Some("`mcdpr commission` finds the sign of an unloaded winch".into()),
            );
        }
        if table.number_given(key!(WINCH, "motor_counts_per_turn")) == Some(0.0) {
            reader.problem(
                &table.at(key!(WINCH, "motor_counts_per_turn")),
                &place,
                "`motor_counts_per_turn` must not be 0".into(),
                Some("`mcdpr commission` finds it, with its sign".into()),
            );
        }
        let winch = winch(&table, index as i64 + 1);
        check_sensor(reader, &table, &winch);
        if let Some(other) = ids.insert(winch.id, place.clone()) {
            reader.problem(
                &table.at(key!(WINCH, "id")),
                &place,
                format!("`id` {} is already the id of {other}", winch.id),
                Some("give every winch its own id".into()),
            );
        }
        if winches
            .first()
            .is_some_and(|first: &Winch| first.drive != winch.drive)
        {
            reader.problem(
                &table.at(key!(WINCH, "drive")),
                &place,
                "`drive` is not that of the first winch: the two protocols' identifiers overlap"
                    .into(),
                Some("give all drives of a board the same protocol".into()),
            );
        }
        if winch.drive == DriveKind::Rmds && winch.node > 15 {
            reader.problem(
                &table.at(key!(WINCH, "node")),
                &place,
                format!("`node` {} is beyond what an rmds drive takes", winch.node),
                Some("number the drive 1 to 15".into()),
            );
        }
        if let Some(other) = nodes.insert(winch.node, place.clone()) {
            reader.problem(
                &table.at(key!(WINCH, "node")),
                &place,
                format!("`node` {} is already the drive of {other}", winch.node),
                Some("give every drive on the bus its own number".into()),
            );
        }
        winches.push(winch);
    }
    winches
}

fn read_module(reader: &mut Reader, table: &Values, modules: &Modules) -> Option<Values> {
    let at = table.at(key!(WINCH, "module"));
    match modules.open(table.text(key!(WINCH, "module"))) {
        Err((what, help)) => {
            reader.problem(&at, &table.place, what, Some(help));
            None
        }
        Ok((name, text)) => {
            let file = reader.add_file(&name, &text);
            let mut module = reader.read(file, &schema::WINCH, "winch module")?;
            for key in [
                key!(WINCH, "module"),
                key!(WINCH, "id"),
                key!(WINCH, "node"),
            ] {
                if module.has(key) {
                    reader.problem(
                        &module.at(key),
                        &module.place,
                        format!("`{}` does not belong in a winch module file", key.name()),
                        Some("write it in the [[winch]] table of the robot file".into()),
                    );
                    module.forget(key);
                }
            }
            Some(module)
        }
    }
}

fn check_sensor(reader: &mut Reader, table: &Values, winch: &Winch) {
    let readable_n = winch.tension_gain_n_per_v * (SENSOR_SUPPLY_V - winch.tension_zero_v);
    if winch.tension_max_n > readable_n * 1.001 {
        reader.problem(
            &table.at(key!(WINCH, "tension_max_n")),
            &table.place,
            format!(
                "`tension_max_n` {} N is more than the sensor shows: \
                 {} N/V x (3.3 V - {} V) = {readable_n:.2} N",
                winch.tension_max_n, winch.tension_gain_n_per_v, winch.tension_zero_v
            ),
            Some("lower tension_max_n, or correct tension_gain_n_per_v and tension_zero_v".into()),
        );
    }
}

fn winch(table: &Values, default_id: i64) -> Winch {
    // The key table has bounded every whole number to its type.
    let small = |number: i64| u8::try_from(number).unwrap_or(u8::MAX);
    let id = table.whole_given(key!(WINCH, "id")).unwrap_or(default_id);
    let gear_ratio = table.number(key!(WINCH, "gear_ratio"));
    Winch {
        id: small(id),
        drum_radius_m: table.number(key!(WINCH, "drum_radius_mm")) / MM_PER_M,
        cable_diameter_m: table.number(key!(WINCH, "cable_diameter_mm")) / MM_PER_M,
        turns_max: table.number(key!(WINCH, "turns_max")),
        drum_inertia_kg_m2: table.number(key!(WINCH, "drum_inertia_kg_m2")),
        encoder_counts_per_turn: u32::try_from(table.whole(key!(WINCH, "encoder_counts_per_turn")))
            .unwrap_or(u32::MAX),
        encoder_sign: if table.whole(key!(WINCH, "encoder_sign")) < 0 {
            -1
        } else {
            1
        },
        motor_counts_per_turn: table
            .number_given(key!(WINCH, "motor_counts_per_turn"))
            .unwrap_or_else(|| (gear_ratio * 4096.0).round()),
        gear_ratio,
        max_motor_rpm: table.number(key!(WINCH, "max_motor_rpm")),
        max_current_a: table.number(key!(WINCH, "max_current_a")),
        torque_constant_nm_per_a: table.number(key!(WINCH, "torque_constant_nm_per_a")),
        rotor_inertia_kg_m2: table.number(key!(WINCH, "rotor_inertia_kg_m2")),
        friction_n: table.number(key!(WINCH, "friction_n")),
        brake_close_s: table.number(key!(WINCH, "brake_close_ms")) / MS_PER_S,
        tension_gain_n_per_v: table.number(key!(WINCH, "tension_gain_n_per_v")),
        tension_zero_v: table.number(key!(WINCH, "tension_zero_v")),
        tension_max_n: table.number(key!(WINCH, "tension_max_n")),
        drive: match table.text(key!(WINCH, "drive")) {
            "cia402" => DriveKind::Cia402,
            _ => DriveKind::Rmds,
        },
        node: small(table.whole_given(key!(WINCH, "node")).unwrap_or(id)),
        drive_bandwidth_rad_s: table.number(key!(WINCH, "drive_bandwidth_rad_s")),
        current_lag_s: table.number(key!(WINCH, "current_lag_ms")) / MS_PER_S,
    }
}
