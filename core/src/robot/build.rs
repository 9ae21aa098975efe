//! From checked values to the robot: units, defaults that follow from other keys, and the checks
//! that need more than one key.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};

use super::model::{
    Bus, Cable, Control, DriveKind, Gripper, GripperKind, Imu, LawKind, Limits, Platform, Robot,
    Surroundings, TensionLaw, TensionOutput, Tool, Winch, anchor_box_in_world_m,
};
use super::modules::ModuleFiles;
use super::read::{Reader, Values};
use super::schema::{self, Named, key};

// Dividing by these rounds once, so that 700 mm is exactly the number nearest to 0.7 m.
pub(super) const MM_PER_M: f64 = 1e3;
pub(super) const MS_PER_S: f64 = 1e3;

/// Most cables of one robot.
pub(super) const CABLES_MAX: usize = 16;

/// Box whose inertia is the default, m.
const BOX_M: [f64; 3] = [0.130, 0.180, 0.040];

/// Two anchors nearer than this are one anchor typed twice, m.
const SAME_POINT_M: f64 = 1e-6;

/// Builds the robot from the file's values; `None` if a mistake has been noted.
pub(super) fn build(
    reader: &mut Reader,
    mut file: Values,
    modules: &dyn ModuleFiles,
) -> Option<Robot> {
    let platform = platform(
        reader,
        &file.take_table(key!(ROBOT, "platform"), &schema::PLATFORM),
    );
    let cables_at = file
        .has(key!(ROBOT, "cable"))
        .then(|| file.at(key!(ROBOT, "cable")));
    let mut cable_tables = file.take_tables(key!(ROBOT, "cable"));
    let common = [
        key!(CABLE, "anchor_mm"),
        key!(CABLE, "attachment_mm"),
        key!(CABLE, "winch"),
        key!(CABLE, "channel"),
    ];
    let all_cables = file.take_table(key!(ROBOT, "all_cables"), &schema::CABLE);
    let all_cables = in_common(reader, all_cables, &common);
    for table in &mut cable_tables {
        table.fill_from(all_cables.clone());
    }
    if let Some(at) = cables_at
        && !(1..=CABLES_MAX).contains(&cable_tables.len())
    {
        let count = cable_tables.len();
        let what = format!("a robot has 1 to {CABLES_MAX} cables, not {count}");
        let help = "write one [[cable]] table per cable";
        reader.problem(&at, schema::ROBOT.title, what, Some(help.into()));
    }
    let mut winch_tables = file.take_tables(key!(ROBOT, "winch"));
    let common = [key!(WINCH, "id"), key!(WINCH, "node")];
    let all_winches = file.take_table(key!(ROBOT, "all_winches"), &schema::WINCH);
    let all_winches = in_common(reader, all_winches, &common);
    // Common keys alone mean one such winch per cable.
    if winch_tables.is_empty() && !all_winches.is_empty() {
        winch_tables = (1..=cable_tables.len())
            .map(|number| {
                let place = format!("winch {number}");
                Values::absent(&schema::WINCH, &place, all_winches.at.clone())
            })
            .collect();
    }
    for table in &mut winch_tables {
        table.fill_from(all_winches.clone());
    }
    let winches_given = !winch_tables.is_empty();

    let winches = super::winches::winches(reader, winch_tables, modules, &cable_tables);
    let cables = cables(reader, &cable_tables, &winches, winches_given);
    let board_tables = file.take_tables(key!(ROBOT, "board"));
    let boards = super::boards::boards(reader, &board_tables, &cable_tables);
    let bus = bus(
        reader,
        &file.take_table(key!(ROBOT, "bus"), &schema::BUS),
        winches_given,
        &winches,
    );
    let limits_table = file.take_table(key!(ROBOT, "limits"), &schema::LIMITS);
    let limits = limits(reader, &limits_table, &winches, winches_given);
    let tension = tension(
        reader,
        &file.take_table(key!(ROBOT, "tension"), &schema::TENSION),
        &limits,
        &winches,
    );
    let tool = file.take_table(key!(ROBOT, "tool"), &schema::TOOL);
    let gripper = file.take_table(key!(ROBOT, "gripper"), &schema::GRIPPER);
    let camera = super::scene::camera(
        reader,
        file.take_table(key!(ROBOT, "camera"), &schema::CAMERA),
    );
    let imu = file.take_table(key!(ROBOT, "imu"), &schema::IMU);
    let tag_tables = file.take_tables(key!(ROBOT, "tag"));
    let tags = super::scene::tags(reader, &tag_tables);

    let surroundings = file.take_table(key!(ROBOT, "surroundings"), &schema::SURROUNDINGS);
    let place_m = |key| surroundings.numbers_given(key).map(point_m);

    let home_m = match tool.numbers_given(key!(TOOL, "home_mm")) {
        Some(mm) => point_m(mm),
        None => below_anchors_m(&cables),
    };

    // After a mistake some values are placeholders: no robot is built of them.
    let mut robot = reader.is_clean().then(|| Robot {
        name: file.text(key!(ROBOT, "name")).to_owned(),
        platform,
        cables,
        winches,
        boards,
        bus,
        tension,
        tool: Tool {
            tcp_in_platform_m: point_m(&tool.numbers(key!(TOOL, "tcp_mm"))),
            home_in_world_m: home_m,
        },
        gripper: Gripper {
            kind: match gripper.text(key!(GRIPPER, "kind")) {
                "digital" => GripperKind::Digital,
                _ => GripperKind::None,
            },
            stroke_m: gripper.number(key!(GRIPPER, "stroke_mm")) / MM_PER_M,
            close_s: gripper.number(key!(GRIPPER, "close_ms")) / MS_PER_S,
            switch: gripper.switch(key!(GRIPPER, "switch")),
        },
        camera,
        imu: (imu.text(key!(IMU, "kind")) == "serial").then(|| Imu {
            noise_rad: imu.number(key!(IMU, "noise_deg")).to_radians(),
            baud: u32::try_from(imu.whole(key!(IMU, "baud"))).unwrap_or(u32::MAX),
        }),
        tags,
        surroundings: Surroundings {
            target_m: place_m(key!(SURROUNDINGS, "target_mm")),
            tray_m: place_m(key!(SURROUNDINGS, "tray_mm")),
            release_m: place_m(key!(SURROUNDINGS, "release_mm")),
        },
        limits,
        calibrated: None,
        chosen: None,
    })?;
    super::auto::choose(reader, &cable_tables, &mut robot)?;
    Some(robot)
}

/// Values for all tables of a section. Keys that cannot be the same in each are refused.
fn in_common(reader: &mut Reader, mut table: Values, own: &[Named]) -> Values {
    for key in own {
        if table.has(*key) {
            let what = format!("`{}` cannot be the same in all tables", key.name());
            let help = format!("write it in each {} table", table.section_title());
            reader.problem(&table.at(*key), &table.place.clone(), what, Some(help));
            table.forget(*key);
        }
    }
    table
}

/// Default tool position: the middle of the anchors, a quarter of their diagonal below the lowest.
fn below_anchors_m(cables: &[Cable]) -> Vector3<f64> {
    let [low, high] = anchor_box_in_world_m(cables);
    let middle = (low + high) / 2.0;
    let drop_m = (high - low).norm() / 4.0;
    Vector3::new(middle.x, middle.y, low.z - drop_m)
}

/// Three numbers in mm as a point in m. Fewer numbers mean a value that was already refused: zeros.
pub(super) fn point_m(mm: &[f64]) -> Vector3<f64> {
    match mm {
        [x, y, z, ..] => Vector3::new(*x, *y, *z) / MM_PER_M,
        _ => Vector3::zeros(),
    }
}

fn platform(reader: &mut Reader, table: &Values) -> Platform {
    let mass_kg = table.number(key!(PLATFORM, "mass_kg"));
    let inertia_kg_m2 = match table.numbers_given(key!(PLATFORM, "inertia_kg_m2")) {
        Some(&[xx, yy, zz]) => Matrix3::from_diagonal(&Vector3::new(xx, yy, zz)),
        Some(&[xx, yy, zz, xy, xz, yz]) => Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
        _ => {
            // A homogeneous box of the assumed size (docs/paper-notes.md): m (b^2 + c^2) / 12.
            let [a, b, c] = BOX_M.map(|edge| edge * edge * mass_kg / 12.0);
            Matrix3::from_diagonal(&Vector3::new(b + c, a + c, a + b))
        }
    };
    let mut moments: Vec<f64> = inertia_kg_m2
        .symmetric_eigenvalues()
        .iter()
        .copied()
        .collect();
    moments.sort_by(f64::total_cmp);
    // Of any distribution of mass the greatest moment is at most the sum of the others. A thin
    // plate has equality, up to rounding.
    if let [least, middle, greatest] = moments[..]
        && (least <= 0.0 || greatest > (least + middle) * (1.0 + 1e-9))
    {
        reader.problem(
            &table.at(key!(PLATFORM, "inertia_kg_m2")),
            &table.place,
            format!(
                "`inertia_kg_m2` belongs to no rigid body: its principal moments are \
                 {least:.3e}, {middle:.3e} and {greatest:.3e} kg m2"
            ),
            Some(
                "each principal moment is greater than 0 and none exceeds the sum of the other two"
                    .into(),
            ),
        );
    }
    Platform {
        mass_kg,
        center_of_mass_m: point_m(&table.numbers(key!(PLATFORM, "center_of_mass_mm"))),
        inertia_kg_m2,
    }
}

fn cables(
    reader: &mut Reader,
    tables: &[Values],
    winches: &[Winch],
    winches_given: bool,
) -> Vec<Cable> {
    let mut cables: Vec<Cable> = Vec::new();
    let mut users: BTreeMap<i64, String> = BTreeMap::new();
    for (index, table) in tables.iter().enumerate() {
        let id = table
            .whole_given(key!(CABLE, "winch"))
            .unwrap_or(index as i64 + 1);
        let found = winches.iter().position(|winch| i64::from(winch.id) == id);
        if found.is_none() {
            let ids: Vec<String> = winches.iter().map(|winch| winch.id.to_string()).collect();
            reader.problem(
                &table.at(key!(CABLE, "winch")),
                &table.place,
                format!("`winch` {id} is not the id of any [[winch]]"),
                Some(format!("the winches of this file: {}", ids.join(", "))),
            );
        }
        if let Some(other) = users.insert(id, table.place.clone()) {
            let help = if winches_given {
                "name another winch, or add a [[winch]] table"
            } else {
                "name another winch"
            };
            reader.problem(
                &table.at(key!(CABLE, "winch")),
                &table.place,
                format!("`winch` {id} already drives {other}"),
                Some(format!("a winch drives one cable: {help}")),
            );
        }
        let axis = table.numbers(key!(CABLE, "swivel_axis"));
        let axis = match axis[..] {
            [x, y, z] => Vector3::new(x, y, z),
            _ => Vector3::z(),
        };
        let swivel_axis_in_world = axis.try_normalize(1e-9).unwrap_or_else(|| {
            reader.problem(
                &table.at(key!(CABLE, "swivel_axis")),
                &table.place,
                "`swivel_axis` is zero: it has no direction".into(),
                Some(
                    "give the direction in which the cable travels when it reaches the pulley, \
                     [0, 0, 1] if it comes from below"
                        .into(),
                ),
            );
            Vector3::z()
        });
        let anchor_in_world_m = point_m(&table.numbers(key!(CABLE, "anchor_mm")));
        let twin = cables
            .iter()
            .position(|other| (other.anchor_in_world_m - anchor_in_world_m).norm() < SAME_POINT_M);
        if let (Some(twin), true) = (twin, table.has(key!(CABLE, "anchor_mm"))) {
            reader.problem(
                &table.at(key!(CABLE, "anchor_mm")),
                &table.place,
                format!(
                    "`anchor_mm` is the same point as that of cable {}",
                    twin + 1
                ),
                Some("measure both anchors again: each cable has an anchor of its own".into()),
            );
        }
        cables.push(Cable {
            anchor_in_world_m,
            swivel_axis_in_world,
            pulley_radius_m: table.number(key!(CABLE, "pulley_radius_mm")) / MM_PER_M,
            attachment_in_platform_m: point_m(&table.numbers(key!(CABLE, "attachment_mm"))),
            // A missing winch has been reported: no robot with this index is built.
            winch_index: found.unwrap_or(0),
            control: match table.text(key!(CABLE, "control")) {
                "tension" => Control::Tension,
                _ => Control::Position,
            },
            ea_n: table.number(key!(CABLE, "ea_n")),
            damping_time_s: table.number(key!(CABLE, "damping_time_ms")) / MS_PER_S,
            routing_length_m: table.number(key!(CABLE, "routing_length_mm")) / MM_PER_M,
            pulley_loss: table.number(key!(CABLE, "pulley_loss")),
        });
    }
    cables
}

fn bus(reader: &mut Reader, table: &Values, winches_given: bool, winches: &[Winch]) -> Bus {
    let bitrate = table.whole(key!(BUS, "bitrate"));
    if ![125_000, 250_000, 500_000, 1_000_000].contains(&bitrate) {
        reader.problem(
            &table.at(key!(BUS, "bitrate")),
            &table.place,
            format!("`bitrate` {bitrate} is not a bit rate of the bus"),
            Some("125000, 250000, 500000 or 1000000".into()),
        );
    }
    let rmds = winches.iter().any(|winch| winch.drive == DriveKind::Rmds);
    if winches_given && rmds && bitrate < 500_000 {
        reader.problem(
            &table.at(key!(BUS, "bitrate")),
            &table.place,
            format!("`bitrate` {bitrate} is not one that an rmds drive speaks"),
            Some("500000 or 1000000".into()),
        );
    }
    // The same frames take twice the time at half the bit rate.
    let standard_us = if bitrate < 1_000_000 { 4000 } else { 2000 };
    let period_us = table
        .whole_given(key!(BUS, "period_us"))
        .unwrap_or(standard_us);
    if period_us % 1000 != 0 {
        reader.problem(
            &table.at(key!(BUS, "period_us")),
            &table.place,
            format!("`period_us` {period_us} is not a whole number of milliseconds"),
            Some("the board commands the drives on its 1 ms tick: 1000, 2000, 4000, ...".into()),
        );
    }
    let given = table.whole_given(key!(BUS, "tension_period_us"));
    let tension_us = given.unwrap_or(period_us);
    // A consequence of a wrong period_us is not reported as a second mistake.
    if given.is_some() && (tension_us % 1000 != 0 || period_us % tension_us.max(1) != 0) {
        reader.problem(
            &table.at(key!(BUS, "tension_period_us")),
            &table.place,
            format!("`tension_period_us` {tension_us} does not divide period_us {period_us}"),
            Some("whole milliseconds that go into period_us a whole number of times".into()),
        );
    }
    Bus {
        tension_period_us: u32::try_from(tension_us).unwrap_or(0),
        bitrate: u32::try_from(bitrate).unwrap_or(0),
        period_us: u32::try_from(period_us).unwrap_or(0),
    }
}

fn limits(reader: &mut Reader, table: &Values, winches: &[Winch], winches_given: bool) -> Limits {
    let least = |of: fn(&Winch) -> f64| winches.iter().map(of).fold(f64::INFINITY, f64::min);
    let trusted_n = least(Winch::trusted_tension_n);
    let tension_min_n = table.number(key!(LIMITS, "tension_min_n"));
    let tension_max_n = table
        .number_given(key!(LIMITS, "tension_max_n"))
        .unwrap_or(trusted_n);
    if tension_min_n >= tension_max_n {
        reader.problem(
            &table.at(key!(LIMITS, "tension_min_n")),
            &table.place,
            format!(
                "`tension_min_n` {tension_min_n} N is not below tension_max_n {tension_max_n} N"
            ),
            Some("lower tension_min_n or raise tension_max_n".into()),
        );
    }
    // Without winch tables the robot is only used for computation: there is no sensor range to
    // exceed.
    if winches_given && tension_max_n > trusted_n {
        reader.problem(
            &table.at(key!(LIMITS, "tension_max_n")),
            &table.place,
            format!(
                "`tension_max_n` {tension_max_n} N is more than the weakest tension sensor can be \
                 trusted to show, {trusted_n:.2} N: 90 % of what it reads before it counts as open"
            ),
            Some(
                "lower it, or correct tension_gain_n_per_v, tension_zero_v and tension_max_n of \
                 the [[winch]]"
                    .into(),
            ),
        );
    }
    let box_in_world_m = table.numbers_given(key!(LIMITS, "box_mm")).map(|numbers| {
        let (low, high) = numbers.split_at(numbers.len() / 2);
        [point_m(low), point_m(high)]
    });
    if let Some([low, high]) = box_in_world_m
        && (0..3).any(|axis| low[axis] > high[axis])
    {
        reader.problem(
            &table.at(key!(LIMITS, "box_mm")),
            &table.place,
            "`box_mm` is empty: its first corner exceeds its second one".into(),
            Some("[[least x, y, z], [greatest x, y, z]]".into()),
        );
    }
    Limits {
        // The slowest winch limits a motion straight along its cable.
        speed_mps: table
            .number_given(key!(LIMITS, "speed_mps"))
            .unwrap_or_else(|| least(Winch::max_cable_speed_mps)),
        acceleration_mps2: table.number(key!(LIMITS, "acceleration_mps2")),
        jerk_mps3: table.number(key!(LIMITS, "jerk_mps3")),
        box_in_world_m,
        tension_min_n,
        tension_max_n,
        tilt_max_rad: table.number(key!(LIMITS, "tilt_max_deg")).to_radians(),
    }
}

fn tension(reader: &mut Reader, table: &Values, limits: &Limits, winches: &[Winch]) -> TensionLaw {
    let law = TensionLaw {
        setpoint_n: table.number(key!(TENSION, "setpoint_n")),
        law: match table.text(key!(TENSION, "law")) {
            "pd" => LawKind::Pd,
            _ => LawKind::Default,
        },
        output: match table.text(key!(TENSION, "output")) {
            "velocity" => TensionOutput::Velocity,
            "current" => TensionOutput::Current,
            // A current that is small beside a gear's friction does not move the drum.
            _ if winches.iter().any(Winch::has_lossy_gear) => TensionOutput::Velocity,
            _ => TensionOutput::Current,
        },
        kp: table.number(key!(TENSION, "kp")),
        kd: table.number(key!(TENSION, "kd")),
        ki: table.number(key!(TENSION, "ki")),
        damping_ns_per_m: table.number(key!(TENSION, "damping_ns_per_m")),
        filter_hz: table.number(key!(TENSION, "filter_hz")),
        corner_hz: table.number(key!(TENSION, "corner_hz")),
        gain_length_m: table.number(key!(TENSION, "gain_length_mm")) * 1e-3,
        hold_braked: table.text(key!(TENSION, "hold_brakes")) == "closed",
        floor_n: table.number(key!(TENSION, "floor_n")),
        ceiling_n: table
            .number_given(key!(TENSION, "ceiling_n"))
            // A tenth of room below the limit at which the board stops (C2).
            .unwrap_or(0.9 * limits.tension_max_n),
    };
    let mut refuse = |key: Named, what: String, help: &str| {
        reader.problem(&table.at(key), &table.place, what, Some(help.into()));
    };
    if law.floor_n > law.setpoint_n {
        refuse(
            key!(TENSION, "setpoint_n"),
            format!(
                "`setpoint_n` {} N is below floor_n {} N",
                law.setpoint_n, law.floor_n
            ),
            "raise setpoint_n or lower floor_n",
        );
    }
    if law.setpoint_n > law.ceiling_n {
        refuse(
            key!(TENSION, "setpoint_n"),
            format!(
                "`setpoint_n` {} N is above ceiling_n {} N",
                law.setpoint_n, law.ceiling_n
            ),
            "lower setpoint_n or raise ceiling_n (and tension_max_n of [limits])",
        );
    }
    if law.ceiling_n > limits.tension_max_n {
        refuse(
            key!(TENSION, "ceiling_n"),
            format!(
                "`ceiling_n` {} N is above tension_max_n {} N of [limits]",
                law.ceiling_n, limits.tension_max_n
            ),
            "lower ceiling_n or raise tension_max_n",
        );
    }
    law
}
