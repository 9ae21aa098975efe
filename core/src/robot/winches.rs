//! The winches of the file: module files, defaults, and the checks among winches.

use std::collections::BTreeMap;

use super::build::{MM_PER_M, MS_PER_S};
use super::model::{DriveKind, Gear, USUAL_COGGING_PER_TURN, Winch};
use super::modules::{self, ModuleFiles};
use super::read::{Reader, Values};
use super::schema::{self, Named, key};

/// Supply of the tension sensor's converter, V: the board reads no voltage above it.
const SENSOR_SUPPLY_V: f64 = 3.3;

/// The winches of the file, or one of defaults per cable.
pub(super) fn winches(
    reader: &mut Reader,
    tables: Vec<Values>,
    modules: &dyn ModuleFiles,
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
        check_gear(reader, &table, &winch);
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

fn read_module(reader: &mut Reader, table: &Values, modules: &dyn ModuleFiles) -> Option<Values> {
    let at = table.at(key!(WINCH, "module"));
    match modules::open(modules, table.text(key!(WINCH, "module"))) {
        Err((what, help)) => {
            reader.problem(&at, &table.place, what, Some(help));
            None
        }
        Ok((name, text)) => {
            let file = reader.add_file(&name, &text);
            let mut module = reader.read(file, &schema::WINCH, "winch module")?;
            let key = key!(WINCH, "module");
            if module.has(key) {
                reader.problem(
                    &module.at(key),
                    &module.place,
                    "`module` does not belong in a winch module file".into(),
                    Some("write it in the [[winch]] table of the robot file".into()),
                );
                module.forget(key);
            }
            Some(module)
        }
    }
}

fn check_sensor(reader: &mut Reader, table: &Values, winch: &Winch) {
    let readable_n = winch.tension_gain_n_per_v * (SENSOR_SUPPLY_V - winch.tension_zero_v);
    // 0.1 % for rounding: the paper's 39.1434 N are 0.02 % more than its k and u_0 give.
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
    let drum_radius_m = table.number(key!(WINCH, "drum_radius_mm")) / MM_PER_M;
    Winch {
        id: small(id),
        drum_radius_m,
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
            // Assumed: a motor encoder of 4096 counts (docs/paper-notes.md).
            .unwrap_or_else(|| (gear_ratio * 4096.0).round()),
        gear_ratio,
        max_motor_rpm: table.number(key!(WINCH, "max_motor_rpm")),
        max_current_a: table.number(key!(WINCH, "max_current_a")),
        torque_constant_nm_per_a: table.number(key!(WINCH, "torque_constant_nm_per_a")),
        rotor_inertia_kg_m2: table.number(key!(WINCH, "rotor_inertia_kg_m2")),
        friction_n: table.number(key!(WINCH, "friction_n")),
        gear: gear(table),
        drum_eccentricity_m: table.number(key!(WINCH, "drum_eccentricity_mm")) / MM_PER_M,
        brake_close_s: table.number(key!(WINCH, "brake_close_ms")) / MS_PER_S,
        brake_holding_n: table.number(key!(WINCH, "brake_holding_n")),
        drive_hold_up_s: table.number(key!(WINCH, "drive_hold_up_ms")) / MS_PER_S,
        brake_play_m: table.number(key!(WINCH, "brake_play_deg")).to_radians() * drum_radius_m,
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

/// mN m in N m, and mN m per 1000 rpm in N m per rpm.
const MNM: f64 = 1e-3;
const MNM_PER_KRPM: f64 = 1e-6;

/// The gear, where the file gives motor and drum a shaft between them.
fn gear(table: &Values) -> Option<Gear> {
    let stiffness_nm_per_rad = table.number(key!(WINCH, "torsional_stiffness_nm_per_rad"));
    let efficiency = table.number(key!(WINCH, "gear_efficiency"));
    (stiffness_nm_per_rad > 0.0).then(|| Gear {
        rotor_friction_nm: table.number(key!(WINCH, "rotor_friction_mnm")) * MNM,
        gear_friction_nm: table.number(key!(WINCH, "gear_friction_mnm")) * MNM,
        static_friction: table.number(key!(WINCH, "static_friction")),
        stribeck_rpm: table.number(key!(WINCH, "stribeck_rpm")),
        viscous_nm_per_rpm: table.number(key!(WINCH, "viscous_mnm_per_krpm")) * MNM_PER_KRPM,
        efficiency,
        // The same loss of force in both directions.
        backdrive_efficiency: table
            .number_given(key!(WINCH, "backdrive_efficiency"))
            .unwrap_or_else(|| (2.0 - 1.0 / efficiency).max(0.0)),
        play_rad: table.number(key!(WINCH, "play_deg")).to_radians(),
        stiffness_nm_per_rad,
        cogging_nm: table.number(key!(WINCH, "cogging_mnm")) * MNM,
        cogging_per_turn: u16::try_from(table.whole(key!(WINCH, "cogging_per_turn")))
            .unwrap_or(USUAL_COGGING_PER_TURN),
        cold_friction: table.number(key!(WINCH, "cold_friction")),
    })
}

/// Refuses contradictions: a gear without a connection, a motor without inertia behind a shaft, a
/// motor that cannot turn its own winch.
fn check_gear(reader: &mut Reader, table: &Values, winch: &Winch) {
    // Keys that are valid only with a shaft between motor and drum.
    let keys: [Named; 9] = [
        key!(WINCH, "rotor_friction_mnm"),
        key!(WINCH, "gear_friction_mnm"),
        key!(WINCH, "viscous_mnm_per_krpm"),
        key!(WINCH, "gear_efficiency"),
        key!(WINCH, "backdrive_efficiency"),
        key!(WINCH, "play_deg"),
        key!(WINCH, "cogging_mnm"),
        key!(WINCH, "cogging_per_turn"),
        key!(WINCH, "cold_friction"),
    ];
    let named = keys.into_iter().find(|key| table.has(*key));
    if let (Some(key), None) = (named, &winch.gear) {
        reader.problem(
            &table.at(key),
            &table.place,
            format!(
                "`{}` means nothing without `torsional_stiffness_nm_per_rad`",
                key.name()
            ),
            Some("give the shaft between motor and drum its stiffness, e.g. 400".into()),
        );
    }
    if winch.gear.is_none() {
        return;
    }
    if winch.rotor_inertia_kg_m2 <= 0.0 {
        reader.problem(
            &table.at(key!(WINCH, "rotor_inertia_kg_m2")),
            &table.place,
            "`rotor_inertia_kg_m2` is 0: behind a shaft a rotor needs its inertia".into(),
            Some("write the motor's, e.g. 1e-7".into()),
        );
    }
    let (needed_n, most_n) = (winch.driving_force_n(0.0), winch.max_force_n());
    if needed_n >= most_n {
        reader.problem(
            &table.at(key!(WINCH, "max_current_a")),
            &table.place,
            format!(
                "`max_current_a` {} A gives {most_n:.1} N at the cable, and friction takes \
                 {needed_n:.1} N: the winch cannot turn",
                winch.max_current_a
            ),
            Some("raise max_current_a, or correct the friction".into()),
        );
    }
}
