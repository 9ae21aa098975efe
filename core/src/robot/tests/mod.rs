//! Robot files: the shipped ones, the defaults, and a golden message per kind of mistake.

use miette::Diagnostic;
use nalgebra::{DMatrix, DVector, Vector3};

use super::schema::{self, Absent, Kind, Range, SECTIONS};
use super::*;

mod golden;

const LEAST: &str = r#"name = "least"
[platform]
[[cable]]
anchor_mm = [0, 0, 1000]
attachment_mm = [0, 0, 0]
[[cable]]
anchor_mm = [1000, 0, 1000]
attachment_mm = [0, 0, 0]
"#;

fn close(a: f64, b: f64, what: &str) {
    assert!((a - b).abs() <= 1e-12 * b.abs().max(1.0), "{what}: {a} {b}");
}

fn parse(text: &str) -> Result<Robot, RobotError> {
    Robot::parse(text, "my/robot.toml", &BuiltInModules)
}

/// The mistakes of a text, one line each.
fn mistakes(text: &str) -> Vec<String> {
    match parse(text) {
        Ok(_) => Vec::new(),
        Err(error) => error.problems().iter().map(ToString::to_string).collect(),
    }
}

/// The only mistake of a text, with its help.
fn mistake(text: &str) -> (String, String) {
    let error = parse(text).expect_err("must be refused");
    let problems = error.problems();
    assert_eq!(problems.len(), 1, "{problems:#?}");
    let help = problems[0].help.clone().unwrap_or_default();
    (problems[0].to_string(), help)
}

#[test]
fn every_shipped_robot_parses_under_its_name() {
    let folder = format!("{}/../robots", env!("CARGO_MANIFEST_DIR"));
    let files = std::fs::read_dir(folder).unwrap();
    let files = files.filter(|file| file.as_ref().unwrap().path().extension().is_some());
    assert_eq!(BUILT_IN.len(), files.count(), "robots/*.toml");
    for (name, _) in BUILT_IN {
        let robot = Robot::built_in(name).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(robot.name, *name);
    }
}

#[test]
fn a_built_in_robot_is_the_file_in_the_repository() {
    for (name, _) in BUILT_IN {
        let path = format!("{}/../robots/{name}.toml", env!("CARGO_MANIFEST_DIR"));
        let text = std::fs::read_to_string(path).unwrap();
        let read = Robot::parse(&text, name, &BuiltInModules);
        assert_eq!(Robot::built_in(name).unwrap(), read.unwrap());
    }
}

#[test]
fn paper_optimistic_has_the_papers_numbers_in_si() {
    let robot = Robot::built_in("paper-optimistic").unwrap();
    let anchors: Vec<Vector3<f64>> = robot
        .cables
        .iter()
        .map(|cable| cable.anchor_in_world_m * 1e3)
        .collect();
    let expected = [
        [25.102, -370.603, 24.100],
        [40.201, 384.903, 24.200],
        [644.503, 370.101, 24.500],
        [629.502, -385.401, 23.900],
    ];
    for (anchor, expected) in anchors.iter().zip(expected) {
        assert!((anchor - Vector3::from(expected)).norm() < 1e-9);
    }
    let controls: Vec<Control> = robot.cables.iter().map(|cable| cable.control).collect();
    assert_eq!(controls[..3], [Control::Position; 3]);
    assert_eq!(controls[3], Control::Tension);
    for (index, winch) in robot.winches.iter().enumerate() {
        assert_eq!(robot.winch_of(index), Some(winch));
        // rho = 371.13, 45 mm/s, 34 kg, 0.03 mm per count: worked out by hand from the file.
        assert!((winch.motor_counts_per_encoder_count() - 371.13).abs() < 2e-4);
        assert!((winch.max_cable_speed_mps() - 0.045_147).abs() < 1e-6);
        assert!((winch.effective_mass_kg() - 34.534).abs() < 1e-2);
        assert!((winch.max_force_n() - 55.67).abs() < 1e-2);
        assert!(robot.limits.speed_mps <= winch.max_cable_speed_mps());
    }
    let rotation = robot.camera.camera_from_platform.rotation;
    // [180, 0, 90] degrees: the platform's x is the picture's y, its z points at the camera.
    let nominal = nalgebra::Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0);
    assert!((rotation.matrix() - nominal).norm() < 4e-3, "{rotation}");
}

#[test]
fn a_module_file_gives_the_winches_of_table3_what_table5_writes_out() {
    let table3 = Robot::built_in("paper-table3").unwrap();
    let table5 = Robot::built_in("paper-table5").unwrap();
    assert_eq!(table3.winches, table5.winches);
}

#[test]
fn name_platform_and_cables_are_enough() {
    let robot = parse(LEAST).unwrap();
    close(robot.platform.mass_kg, 1.4, "mass");
    close(robot.platform.center_of_mass_m.z, -0.03, "centre of mass");
    let box_xx = 1.4 / 12.0 * (0.18f64.powi(2) + 0.04f64.powi(2));
    close(robot.platform.inertia_kg_m2[(0, 0)], box_xx, "inertia");
    assert_eq!(robot.winches.len(), 2);
    assert_eq!(robot.winches[1].id, 2);
    assert_eq!(robot.winches[1].node, 2);
    close(
        robot.winches[0].motor_counts_per_turn,
        1_520_148.0,
        "counts",
    );
    assert_eq!(robot.cables[1].winch_index, 1);
    assert_eq!(robot.cables[1].control, Control::Position);
    close(robot.cables[0].pulley_radius_m, 0.01, "radius");
    close(robot.cables[0].routing_length_m, 0.7, "routing");
    close(robot.cables[0].damping_time_s, 2e-4, "damping");
    assert_eq!(
        robot.bus,
        Bus {
            bitrate: 1_000_000,
            period_us: 2000,
            tension_period_us: 2000,
        }
    );
    // Nine tenths of the 38.72 N at which the board takes the sensor's input for open.
    let trusted_n = robot.winches[0].trusted_tension_n();
    assert!((34.84..34.853).contains(&trusted_n), "{trusted_n}");
    close(robot.limits.tension_max_n, trusted_n, "tension_max");
    close(robot.tension.ceiling_n, 0.9 * trusted_n, "ceiling");
    close(
        robot.limits.speed_mps,
        robot.winches[0].max_cable_speed_mps(),
        "speed",
    );
    assert_eq!(robot.gripper.kind, GripperKind::None);
    close(robot.camera.lens.center_px[0], 640.0, "cx");
    assert!(robot.tags.is_empty());
    // The platform table itself may be left out too.
    assert_eq!(parse(&LEAST.replace("[platform]\n", "")).unwrap(), robot);
}

#[test]
fn defaults_that_follow_from_other_keys_follow_them() {
    let text = format!(
        "{LEAST}[[winch]]\ngear_ratio = 27\n[[winch]]\n[bus]\nbitrate = 500000\n[[tag]]\nsize_mm = 40\n[[tag]]\n"
    );
    let robot = parse(&text).unwrap();
    close(
        robot.winches[0].motor_counts_per_turn,
        110_592.0,
        "27 x 4096",
    );
    assert_eq!(robot.bus.period_us, 4000);
    assert_eq!((robot.tags[1].id, robot.tags[1].body), (1, 1));
    assert_eq!(
        robot.tags[0].corners_in_body_m[2],
        Vector3::new(0.02, 0.02, 0.0)
    );
    // The slower winch limits.
    close(
        robot.limits.speed_mps,
        robot.winches[1].max_cable_speed_mps(),
        "speed",
    );
}

#[test]
fn search_box_is_the_limits_box_or_hangs_below_the_anchors() {
    let robot = parse(LEAST).unwrap();
    let [low, high] = robot.search_box_in_world_m();
    assert_eq!((low.z, high.z), (0.0, 1.0));
    let [low, high] = Robot::built_in("planar-four")
        .unwrap()
        .search_box_in_world_m();
    assert_eq!(low, Vector3::new(-0.7, 0.0, 0.25));
    assert_eq!(high, Vector3::new(0.7, 0.0, 0.95));
}

#[test]
fn hash_sees_values_and_not_their_spelling() {
    let robot = parse(LEAST).unwrap();
    let same = LEAST.replace("[platform]", "# a comment\n[platform]\nmass_kg = 1.40");
    let other = LEAST.replace("[platform]", "[platform]\nmass_kg = 1.4000001");
    assert_eq!(parse(&same).unwrap().content_hash(), robot.content_hash());
    assert_ne!(parse(&other).unwrap().content_hash(), robot.content_hash());
    let hashes: std::collections::BTreeSet<u32> = BUILT_IN
        .iter()
        .map(|(name, _)| Robot::built_in(name).unwrap().content_hash())
        .collect();
    assert_eq!(hashes.len(), BUILT_IN.len());
}

#[test]
fn all_mistakes_are_reported_in_the_order_of_the_file() {
    let text = LEAST
        .replace("[platform]", "[platform]\nmass_kg = 0\nfoo_bar = 1")
        .replace("[1000, 0, 1000]", "[1000]");
    let lines: Vec<String> = mistakes(&text);
    assert_eq!(lines.len(), 3, "{lines:#?}");
    for (line, place) in lines.iter().zip(["toml:3:", "toml:4:", "toml:9:"]) {
        assert!(line.contains(place), "{lines:#?}");
    }
    let error = parse(&text).unwrap_err();
    assert!(
        error.to_string().ends_with("(and 2 more mistakes)"),
        "{error}"
    );
    assert_eq!(error.related().map(Iterator::count), Some(2));
}

#[test]
fn the_excerpt_points_at_the_value() {
    let text = LEAST.replace("[platform]", "[platform]\nmass_kg = -1.5");
    let error = parse(&text).unwrap_err();
    let label = error.labels().unwrap().next().unwrap();
    assert_eq!(&text[label.offset()..label.offset() + label.len()], "-1.5");
    let shown = format!("{:?}", miette::Report::new(error));
    assert!(shown.contains("my/robot.toml:3"), "{shown}");
}

#[test]
fn more_than_sixteen_cables_are_refused() {
    let mut text = String::from("name = \"many\"\n");
    for index in 0..17 {
        text += &format!("[[cable]]\nanchor_mm = [{index}, 0, 0]\nattachment_mm = [0, 0, 0]\n");
    }
    assert!(mistakes(&text)[0].contains("1 to 16 cables, not 17"));
}

#[test]
fn every_key_with_its_default_is_in_the_document() {
    let path = format!("{}/../docs/robot-file.md", env!("CARGO_MANIFEST_DIR"));
    let document = std::fs::read_to_string(path).unwrap();
    for section in SECTIONS {
        let header = format!("## `{}`", section.title);
        let header = if std::ptr::eq(section, &schema::ROBOT) {
            "## The file".into()
        } else {
            header
        };
        let text = document
            .split(&header)
            .nth(1)
            .unwrap_or_else(|| panic!("docs/robot-file.md has no heading {header}"))
            .split("\n## ")
            .next()
            .unwrap_or("");
        for key in section.keys {
            let row = format!(
                "| `{}` | {} | {} |",
                key.name,
                key.absent.in_words(),
                key.meaning
            );
            assert!(
                text.contains(&row),
                "under {header} this row is missing:\n{row}"
            );
        }
    }
}

#[test]
fn the_key_table_is_consistent() {
    for section in SECTIONS {
        for key in section.keys {
            let fits = match (key.absent, key.kind) {
                (Absent::Required | Absent::Follows(_), _) => true,
                (Absent::Number(number), Kind::Number(range)) => range.contains(number),
                (Absent::Numbers(list), Kind::List(counts, _)) => counts.contains(&list.len()),
                (Absent::Whole(number), Kind::Whole(low, high)) => (low..=high).contains(&number),
                (Absent::Word(word), Kind::Word(words)) => words.contains(&word),
                (Absent::Switch(_), Kind::Switch) => true,
                _ => false,
            };
            assert!(fits, "{} {}", section.title, key.name);
        }
    }
    assert!(!Range::Finite.contains(f64::NAN));
    assert!(!Range::Positive.contains(f64::INFINITY));
}

/// Structure matrix of a level platform at `p`, cables taken as straight lines to the anchors.
fn structure_matrix(robot: &Robot, p: Vector3<f64>) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(6, robot.cables.len());
    for (column, cable) in robot.cables.iter().enumerate() {
        let arm = cable.attachment_in_platform_m;
        let pull = (cable.anchor_in_world_m - p - arm).normalize();
        matrix.fixed_view_mut::<3, 1>(0, column).copy_from(&pull);
        matrix
            .fixed_view_mut::<3, 1>(3, column)
            .copy_from(&arm.cross(&pull));
    }
    matrix
}

#[test]
fn the_eight_cable_robot_holds_itself_anywhere_in_its_box() {
    let robot = Robot::built_in("eight-cable").unwrap();
    let [low, high] = robot.search_box_in_world_m();
    let (floor_n, ceiling_n) = (robot.limits.tension_min_n, robot.limits.tension_max_n);
    let mut weight = DVector::zeros(6);
    weight[2] = robot.platform.mass_kg * 9.81;
    for corner in 0..27 {
        let share = |axis: i32| f64::from(corner / 3i32.pow(axis as u32) % 3) / 2.0;
        let share = Vector3::new(share(0), share(1), share(2));
        let p = low + (high - low).component_mul(&share);
        let matrix = structure_matrix(&robot, p);
        assert_eq!(matrix.rank(1e-3), 6, "at {p}");
        // Alternating projections onto equilibrium and onto the tension limits.
        let inverse = matrix.clone().pseudo_inverse(1e-9).unwrap();
        let mut tensions = DVector::from_element(8, 60.0);
        for _ in 0..5000 {
            tensions -= &inverse * (&matrix * &tensions - &weight);
            tensions.apply(|t| *t = t.clamp(floor_n, ceiling_n));
        }
        let residual = (&matrix * &tensions - &weight).norm();
        assert!(residual < 1e-6, "at {p}: {residual} with {tensions}");
    }
}

#[test]
fn the_planar_robot_is_planar_and_point_anchor_has_no_pulleys() {
    for cable in &Robot::built_in("planar-four").unwrap().cables {
        assert_eq!(cable.anchor_in_world_m.y, 0.0);
        assert_eq!(cable.attachment_in_platform_m, Vector3::zeros());
    }
    for cable in &Robot::built_in("point-anchor").unwrap().cables {
        assert_eq!(cable.pulley_radius_m, 0.0);
    }
}

#[test]
fn random_bytes_and_mutations_never_panic() {
    // A small generator suffices here; the seed is fixed.
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    let mut next = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    let base = BUILT_IN[0].1.as_bytes();
    let mut refused = 0;
    for _ in 0..300 {
        let mut bytes = base.to_vec();
        for _ in 0..3 {
            let place = (next() % bytes.len() as u64) as usize;
            bytes[place] = b" \n[]{}=.,\"'0-#einfa_"[(next() % 20) as usize];
        }
        let text = String::from_utf8_lossy(&bytes).into_owned();
        if let Err(error) = parse(&text) {
            refused += 1;
            assert!(!error.problems().is_empty());
        }
    }
    assert!(refused > 50, "{refused}");
}

#[test]
fn values_in_common_count_where_a_table_gives_none() {
    let text = "name = \"common\"\n[all_cables]\nea_n = 30000\npulley_radius_mm = 12\n\
        [all_winches]\nmax_motor_rpm = 5000\nmodule = \"modules/fast-27.toml\"\n\
        [[cable]]\nanchor_mm = [0, 0, 1000]\nattachment_mm = [0, 0, 0]\nea_n = 40000\n\
        [[cable]]\nanchor_mm = [1000, 0, 1000]\nattachment_mm = [0, 0, 0]\n\
        [[cable]]\nanchor_mm = [0, 1000, 1000]\nattachment_mm = [0, 0, 0]\n";
    let robot = Robot::parse(text, "common.toml", &BuiltInModules).unwrap();
    let stiffness: Vec<_> = robot.cables.iter().map(|cable| cable.ea_n).collect();
    assert_eq!(stiffness, [40_000.0, 30_000.0, 30_000.0]);
    assert!(robot.cables.iter().all(|c| c.pulley_radius_m == 0.012));
    // Each cable has a winch of its own: the common values come before those of the module's file.
    let winches: Vec<_> = robot.winches.iter().map(|w| (w.id, w.node)).collect();
    assert_eq!(winches, [(1, 1), (2, 2), (3, 3)]);
    assert!(
        robot
            .winches
            .iter()
            .all(|w| w.max_motor_rpm == 5000.0 && w.gear_ratio == 27.0)
    );
    // Written out, it is the same robot.
    let winch = |id: u8| {
        format!("[[winch]]\nid = {id}\nmax_motor_rpm = 5000\nmodule = \"modules/fast-27.toml\"\n")
    };
    let all = format!("{}{}{}[all_cables]", winch(1), winch(2), winch(3));
    let written = text
        .replace(
            "[all_winches]\nmax_motor_rpm = 5000\nmodule = \"modules/fast-27.toml\"\n",
            "",
        )
        .replace("[all_cables]", &all);
    let same = Robot::parse(&written, "written.toml", &BuiltInModules).unwrap();
    assert_eq!(same.content_hash(), robot.content_hash());
}

#[test]
fn what_cannot_be_common_is_refused_with_its_place() {
    let text = "name = \"common\"\n[all_cables]\nanchor_mm = [0, 0, 1]\nea = 3\n[all_winches]\nid = 2\n\
        [[cable]]\nanchor_mm = [0, 0, 1000]\n";
    let found = mistakes(text);
    for what in [
        "`anchor_mm` cannot be the same",
        "`ea`",
        "`id` cannot be the same",
        "`attachment_mm` is missing",
    ] {
        assert!(
            found.iter().any(|said| said.contains(what)),
            "{what}: {found:?}"
        );
    }
}

#[test]
fn a_tension_law_without_an_output_commands_a_speed_where_a_gear_rubs() {
    let table5 = include_str!("../../../../robots/paper-table5.toml");
    let optimistic = include_str!("../../../../robots/paper-optimistic.toml");
    for (text, output) in [
        (table5, TensionOutput::Velocity),
        (optimistic, TensionOutput::Current),
    ] {
        let lines = text.lines().filter(|line| !line.starts_with("output = "));
        let robot = parse(&lines.collect::<Vec<_>>().join("\n")).unwrap();
        assert_eq!(robot.tension.output, output, "{}", robot.name);
    }
    // What the file says stands: the tension-held drum of this robot has no gear.
    let direct = Robot::built_in("lab-direct").unwrap();
    assert_eq!(direct.tension.output, TensionOutput::Current);
}
