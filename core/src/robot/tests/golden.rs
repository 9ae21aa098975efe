//! One golden message per kind of mistake: file, line, key, and a help that says what to do.

use super::{LEAST, mistake, mistakes};

#[test]
fn golden_messages_name_file_line_key_and_remedy() {
    let add = |more: &str| format!("{LEAST}{more}");
    let cases: Vec<(String, &str, &str)> = vec![
        (
            LEAST.replace("[platform]", "[platform]\nmass = 2"),
            "my/robot.toml:3: [platform]: unknown key `mass` in [platform]",
            "did you mean `mass_kg`?",
        ),
        (
            LEAST.replace("[1000, 0, 1000]", "[1000, 0, 1000]\nanchr_mm = 1"),
            "my/robot.toml:8: cable 2: unknown key `anchr_mm` in [[cable]]",
            "did you mean `anchor_mm`?",
        ),
        (
            LEAST.replace("[platform]", "[platform]\nfilter_hz = 2"),
            "my/robot.toml:3: [platform]: unknown key `filter_hz` in [platform]",
            "`filter_hz` belongs in [tension]",
        ),
        (
            add("[limits]\nzzz = 2\n"),
            "my/robot.toml:10: [limits]: unknown key `zzz` in [limits]",
            "the keys known here: speed_mps, acceleration_mps2",
        ),
        (
            add("[camera]\ncamera_from_platform = { position = [0, 0, 0] }\n"),
            "my/robot.toml:10: camera_from_platform: unknown key `position`",
            "did you mean `position_mm`?",
        ),
        (
            LEAST.replace("[platform]", "[platform]\nmass_kg = -1"),
            "my/robot.toml:3: [platform]: `mass_kg` must be a number greater than 0 (1e-12 to 1e9), not -1",
            "mass with tool and gripper, kg",
        ),
        (
            LEAST.replace("[platform]", "[platform]\nmass_kg = nan"),
            "my/robot.toml:3: [platform]: `mass_kg` must be a number greater than 0 (1e-12 to 1e9), not NaN",
            "mass_kg",
        ),
        (
            LEAST.replace("[platform]", "[platform]\nmass_kg = 1e300"),
            "my/robot.toml:3: [platform]: `mass_kg` must be a number greater than 0 (1e-12 to 1e9), not 1000",
            "mass_kg",
        ),
        (
            LEAST.replace("[1000, 0, 1000]", "[1000, -inf, 1000]"),
            "my/robot.toml:7: cable 2: `anchor_mm` must hold only numbers from -1e9 to 1e9, not -inf",
            "anchor_mm: point B",
        ),
        (
            LEAST.replace("[1000, 0, 1000]", "[1000, 0]"),
            "my/robot.toml:7: cable 2: `anchor_mm` must hold 3 numbers, not 2",
            "anchor_mm: point B",
        ),
        (
            LEAST.replace("[1000, 0, 1000]", "\"here\""),
            "my/robot.toml:7: cable 2: `anchor_mm` must be a list of numbers, [x, y, z], not a string",
            "anchor_mm: point B",
        ),
        (
            LEAST.replace("[1000, 0, 1000]", "[0, 0, 1000]"),
            "my/robot.toml:7: cable 2: `anchor_mm` is the same point as that of cable 1",
            "each cable has an anchor of its own",
        ),
        (
            LEAST.replace("anchor_mm = [1000, 0, 1000]\n", ""),
            "my/robot.toml:6: cable 2: the key `anchor_mm` is missing",
            "add anchor_mm = ...: point B",
        ),
        (
            add("pulley_radius_mm = -10\n"),
            "my/robot.toml:9: cable 2: `pulley_radius_mm` must be a number, 0 or greater (to 1e9), not -10",
            "0 is a point anchor",
        ),
        (
            add("swivel_axis = [0, 0, 0]\n"),
            "my/robot.toml:9: cable 2: `swivel_axis` is zero: it has no direction",
            "[0, 0, 1] if it comes from below",
        ),
        (
            add("control = \"speed\"\n"),
            "my/robot.toml:9: cable 2: `control` must be \"position\" or \"tension\" or \"auto\", not \"speed\"",
            "the cable's length or its tension",
        ),
        (
            add("pulley_loss = 1\n"),
            "my/robot.toml:9: cable 2: `pulley_loss` must be 0 or greater and less than 1, not 1",
            "share of the tension lost",
        ),
        (
            add("winch = 3\n[[winch]]\n[[winch]]\n"),
            "my/robot.toml:9: cable 2: `winch` 3 is not the id of any [[winch]]",
            "the winches of this file: 1, 2",
        ),
        (
            add("winch = 1\n[[winch]]\n[[winch]]\n"),
            "my/robot.toml:9: cable 2: `winch` 1 already drives cable 1",
            "a winch drives one cable: name another winch",
        ),
        (
            add("[[winch]]\nid = 2\n[[winch]]\nid = 2\nnode = 3\n[[winch]]\nid = 1\n"),
            "my/robot.toml:12: winch 2: `id` 2 is already the id of winch 1",
            "give every winch its own id",
        ),
        (
            add("[[winch]]\nnode = 2\n[[winch]]\n"),
            "my/robot.toml:11: winch 2: `node` 2 is already the drive of winch 1",
            "own number",
        ),
        (
            add("[[winch]]\nnode = 16\n[[winch]]\n"),
            "my/robot.toml:10: winch 1: `node` 16 is beyond what an rmds drive takes",
            "1 to 15",
        ),
        (
            add("[[winch]]\nencoder_sign = 0\n[[winch]]\n"),
            "my/robot.toml:10: winch 1: `encoder_sign` must be 1 or -1, not 0",
            "commission",
        ),
        (
            add("[[winch]]\ndrum_radius_mm = 0\n[[winch]]\n"),
            "my/robot.toml:10: winch 1: `drum_radius_mm` must be a number greater than 0 (1e-12 to 1e9), not 0",
            "drum radius",
        ),
        (
            add("[[winch]]\nencoder_counts_per_turn = 4096.5\n[[winch]]\n"),
            "my/robot.toml:10: winch 1: `encoder_counts_per_turn` must be a whole number from 4 to 16777216, not a float",
            "drum encoder counts",
        ),
        (
            add("[[winch]]\ntension_max_n = 50\n[[winch]]\n"),
            "my/robot.toml:10: winch 1: `tension_max_n` 50 N is more than the sensor shows",
            "tension_gain_n_per_v",
        ),
        (
            add("[[winch]]\nmodule = \"../winch.toml\"\n[[winch]]\n"),
            "my/robot.toml:10: winch 1: `module` \"../winch.toml\" leaves the folder of the robot file",
            "put the module file into the robot file's folder",
        ),
        (
            add("[[winch]]\nmodule = \"/etc/winch.toml\"\n[[winch]]\n"),
            "my/robot.toml:10: winch 1: `module` \"/etc/winch.toml\" leaves the folder",
            "relative",
        ),
        (
            add("[[winch]]\nmodule = \"none.toml\"\n[[winch]]\n"),
            "my/robot.toml:10: winch 1: there is no built-in winch module \"none.toml\"",
            "the built-in ones: modules/geared-371.toml",
        ),
        (
            add("[bus]\nbitrate = 300000\n"),
            "my/robot.toml:10: [bus]: `bitrate` 300000 is not a bit rate of the bus",
            "500000 or 1000000",
        ),
        (
            add("[[winch]]\n[[winch]]\n[bus]\nbitrate = 250000\n"),
            "my/robot.toml:12: [bus]: `bitrate` 250000 is not one that an rmds drive speaks",
            "500000 or 1000000",
        ),
        (
            add("[bus]\nperiod_us = 1500\n"),
            "my/robot.toml:10: [bus]: `period_us` 1500 is not a whole number of milliseconds",
            "1 ms tick",
        ),
        (
            add("[tension]\nsetpoint_n = 1\n"),
            "my/robot.toml:10: [tension]: `setpoint_n` 1 N is below floor_n 2 N",
            "raise setpoint_n",
        ),
        (
            add("[tension]\nsetpoint_n = 36\n"),
            "my/robot.toml:10: [tension]: `setpoint_n` 36 N is above ceiling_n",
            "lower setpoint_n",
        ),
        (
            add("[tension]\nceiling_n = 100\n"),
            "my/robot.toml:10: [tension]: `ceiling_n` 100 N is above tension_max_n 34.8",
            "lower ceiling_n",
        ),
        (
            add("[limits]\ntension_min_n = 50\n"),
            "my/robot.toml:10: [limits]: `tension_min_n` 50 N is not below tension_max_n 34.8",
            "lower tension_min_n",
        ),
        (
            add("[[winch]]\n[[winch]]\n[limits]\ntension_max_n = 60\n"),
            "my/robot.toml:12: [limits]: `tension_max_n` 60 N is more than the weakest tension sensor can be trusted to show, 34.8",
            "[[winch]]",
        ),
        (
            add("[limits]\nbox_mm = [[0, 0, 0], [100, 100, -100]]\n"),
            "my/robot.toml:10: [limits]: `box_mm` is empty",
            "[[least x, y, z], [greatest x, y, z]]",
        ),
        (
            add("[limits]\nbox_mm = [0, 0, 0, 100, 100, 100]\n"),
            "my/robot.toml:10: [limits]: `box_mm` must hold 2 rows of 3 numbers",
            "box that the tool may not leave",
        ),
        (
            LEAST.replace("[platform]", "[platform]\ninertia_kg_m2 = [1, 1, 3]"),
            "my/robot.toml:3: [platform]: `inertia_kg_m2` belongs to no rigid body",
            "sum of the other two",
        ),
        (
            add("[camera]\ncx = 2000\n"),
            "my/robot.toml:10: [camera]: `cx` 2000 lies outside the picture of 1280 px",
            "principal point",
        ),
        (
            add("[[tag]]\n[[tag]]\nid = 0\n"),
            "my/robot.toml:11: tag 2: `id` 0 of family 36h11 is already the id of another tag",
            "own id",
        ),
        (
            add("[[tag]]\n[[tag]]\nbody = 0\n"),
            "my/robot.toml:11: tag 2: `body` 0 already carries a tag at the same corners",
            "corners_in_body_mm",
        ),
        (
            add(
                "[[tag]]\ncorners_in_body_mm = [[0, 0, 0], [100, 0, 0], [0, 100, 0], [100, 100, 0]]\n",
            ),
            "my/robot.toml:10: tag 1: `corners_in_body_mm` have edges of 100.0, 141.4, 100.0 and 141.4 mm",
            "detector's order",
        ),
        (
            add("[gripper]\nswitch = 1\n"),
            "my/robot.toml:10: [gripper]: `switch` must be true or false, not an integer",
            "whether a switch",
        ),
        (
            LEAST.replace("name = \"least\"", "name = \" \""),
            "my/robot.toml:1: the robot file: `name` must not be empty",
            "name of the robot",
        ),
        (
            "name = \"x\"\n[platform]\n".into(),
            "my/robot.toml:1: the robot file: the key `cable` is missing",
            "add cable = ...: one table per cable",
        ),
        (
            "name = \"x\"\ncable = []\n".into(),
            "my/robot.toml:2: the robot file: a robot has 1 to 16 cables, not 0",
            "one [[cable]] table per cable",
        ),
        (
            "name = \"x\"\n[cable]\nanchor_mm = [0, 0, 0]\n".into(),
            "my/robot.toml:2: the robot file: `cable` must be a list of tables, each under a header [[cable]]",
            "one table per cable",
        ),
        (
            LEAST.replace("[platform]", "[platform"),
            "my/robot.toml:2: the robot file:",
            "not valid TOML",
        ),
        (
            LEAST.replace("[platform]", "[platform]\nmass_kg = 1\nmass_kg = 2"),
            "my/robot.toml:4: the robot file: duplicate key",
            "not valid TOML",
        ),
        (
            String::new(),
            "my/robot.toml:1: the robot file: the key `name` is missing",
            "",
        ),
    ];
    for (text, message, remedy) in cases {
        let (said, help) = if text.is_empty() {
            (mistakes(&text).remove(0), String::new())
        } else {
            mistake(&text)
        };
        assert!(
            said.starts_with(message),
            "\nsaid   {said}\nwanted {message}"
        );
        assert!(
            help.contains(remedy),
            "\nhelp   {help}\nwanted {remedy}\nof {said}"
        );
    }
}
