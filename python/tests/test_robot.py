"""Robot files: loaded, edited, saved, refused."""

from __future__ import annotations

from pathlib import Path

import mcdpr
import pytest
from conftest import program, refusal


def test_every_built_in_robot_has_the_program_s_values() -> None:
    for name in mcdpr.built_in():
        robot = mcdpr.Robot.load(name)
        assert robot.values == program("config", "show", name, "--json")
        assert robot.cable_count == len(robot.values["cables"])


def test_edits_are_new_robots_and_survive_a_save(tmp_path: Path) -> None:
    robot = mcdpr.Robot.load("paper-table5")
    heavier = robot.edited({"platform.mass_kg": 1.75, "cable.2.anchor_mm": [41.0, 384.0, 24.0]})
    assert heavier.values["platform"]["mass_kg"] == 1.75
    assert heavier.values["cables"][1]["anchor_in_world_m"] == [0.041, 0.384, 0.024]
    assert robot.values["platform"]["mass_kg"] != 1.75
    file = tmp_path / "mine.toml"
    heavier.save(file)
    again = mcdpr.Robot.load(file)
    assert again.values == heavier.values and again.content_hash == heavier.content_hash
    assert program("config", "show", str(file), "--json") == heavier.values


def test_a_wrong_edit_says_what_and_where() -> None:
    robot = mcdpr.Robot.load("paper-table5")
    with pytest.raises(mcdpr.RobotError, match="mass_kg") as refused:
        robot.edited({"platform.mass_kg": -1.0})
    assert refused.value.problems[0]["place"] == "[platform]"
    with pytest.raises(mcdpr.InputError, match="cable 9: 1 to 4"):
        robot.edited({"cable.9.anchor_mm": [0, 0, 0]})
    with pytest.raises(mcdpr.InputError, match="cable.1"):
        robot.edited({"cable.anchor_mm": [0, 0, 0]})
    with pytest.raises(mcdpr.InputError):
        robot.edited({"platform.mass_kg": float("nan")})
    with pytest.raises(mcdpr.RobotError, match="unknown key"):
        robot.edited({"platform.mas_kg": 1.0})


def test_refusals_have_the_program_s_words(tmp_path: Path) -> None:
    file = tmp_path / "broken.toml"
    file.write_text('name = "x"\n[platform]\nmass_kg = 0\nwidth = 3\n')
    with pytest.raises(mcdpr.RobotError) as refused:
        mcdpr.Robot.load(file)
    said = refusal("config", "check", str(file))
    for problem in refused.value.problems:
        assert " ".join(problem["what"].split()) in said or problem["line"] >= 1
    assert " ".join(refused.value.message.split()[1:6]) in said
    with pytest.raises(mcdpr.RobotError, match="no robot file or built-in robot `nosuch`"):
        mcdpr.Robot.load("nosuch")
