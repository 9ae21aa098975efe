"""The exported models, loaded and judged by MuJoCo: a foreign engine at the same poses."""

from __future__ import annotations

import sys
from pathlib import Path

import mcdpr
import mujoco
import numpy as np
import pytest
from conftest import PROGRAM, ROBOTS, ROOT, program

sys.path.insert(0, str(ROOT / "python" / "studies"))

from mcdpr.mujoco_model import MujocoModel  # noqa: E402
from mujoco_flight import fly  # noqa: E402
from mujoco_modes import study as compare_modes  # noqa: E402
from mujoco_statics import study  # noqa: E402


def test_the_program_writes_the_same_files(tmp_path: Path) -> None:
    assert PROGRAM
    robot = mcdpr.Robot.load("paper-table5")
    for kind, text in (("mjcf", robot.to_mjcf()), ("urdf", robot.to_urdf())):
        file = tmp_path / f"robot.{kind}"
        program("model", "export", "--to", kind, "--out", str(file), "--json")
        assert file.read_text() == text


@pytest.mark.parametrize("name", ROBOTS)
def test_lengths_at_home_are_those_of_the_kinematics(name: str) -> None:
    robot = mcdpr.Robot.load(name)
    judge = MujocoModel(robot)
    home = robot.statics(robot.values["tool"]["home_in_world_m"], "setpoint", tool=True)
    judge.put(home)
    cables = robot.values["cables"]
    behind = [
        max(cable["routing_length_m"], 3 * cable["pulley_radius_m"], 0.02) for cable in cables
    ]
    # A length-held winch that has taken up x shows x more of its tendon.
    lengths = judge.data.ten_length - np.array(behind)
    assert np.abs(lengths - home.lengths_m).max() < 1e-9
    mass = judge.model.body("platform").mass[0]
    assert mass == robot.values["platform"]["mass_kg"]
    tool = judge.data.site("tool").xpos
    assert np.abs(tool - robot.values["tool"]["home_in_world_m"]).max() < 1e-9
    lens = robot.values["camera"]
    seen_deg = 2 * np.degrees(np.arctan(lens["height_px"] / 2 / lens["fy_px"]))
    # MuJoCo keeps a camera's field of view in degrees.
    assert abs(judge.model.cam_fovy[0] - seen_deg) < 1e-6
    assert judge.model.ncam == 1 and judge.model.nsensor == 3 * robot.cable_count + 2
    assert judge.model.nu == robot.cable_count


@pytest.mark.parametrize("name", ["paper-optimistic", "eight-cable"])
def test_rest_poses_are_those_of_the_statics(name: str) -> None:
    seen = study(name, 30, seed=1)
    assert seen["unsettled"] == 0
    assert seen["position_mm"] < 0.1
    assert seen["attitude_deg"] < 0.05
    assert seen["tension_n"] < 0.05


@pytest.mark.parametrize(
    ("name", "braked"), [("paper-optimistic", False), ("eight-cable", False), ("eight-cable", True)]
)
def test_modes_are_those_of_the_statics(name: str, braked: bool) -> None:
    # By the robot file: three lengths and a tension, six lengths and two tensions. Braked: eight lengths.
    off = np.abs(compare_modes(name, 12, seed=1, braked=braked))
    assert off.shape == (12, 3 if name == "paper-optimistic" else 6)
    assert off.max() < 0.02, off


def test_the_model_runs_and_the_platform_swings() -> None:
    judge = MujocoModel(mcdpr.Robot.load("paper-optimistic"))
    robot = judge.robot
    home = robot.statics(robot.values["tool"]["home_in_world_m"], "setpoint", tool=True)
    judge.put(home, [0.002, 0.0, 0.0])
    away = []
    for _ in range(100):
        mujoco.mj_step(judge.model, judge.data, 50)
        away.append(np.linalg.norm(judge.position_m - home.position_m))
    assert 5e-4 < max(away) < 0.02 and np.isfinite(away).all()


def test_urdf_is_read_as_it_was_written() -> None:
    robot = mcdpr.Robot.load("eight-cable")
    from xml.etree import ElementTree

    tree = ElementTree.fromstring(robot.to_urdf())
    links = {link.attrib["name"] for link in tree.iter("link")}
    parents = {j.find("child").attrib["link"]: j for j in tree.iter("joint")}  # type: ignore[union-attr]
    assert links - set(parents) == {"world"}, "one root"
    assert all(j.find("parent").attrib["link"] in links for j in parents.values())  # type: ignore[union-attr]
    for cable in range(8):
        origin = parents[f"anchor_{cable + 1}"].find("origin")
        assert origin is not None
        place = [float(x) for x in origin.attrib["xyz"].split()]
        assert place == robot.values["cables"][cable]["anchor_in_world_m"]
    # MuJoCo reads it, too.
    assert mujoco.MjModel.from_xml_string(robot.to_urdf()).nbody >= 2


def test_a_robot_that_the_format_cannot_express_is_refused() -> None:
    with pytest.raises(mcdpr.KinematicsError, match="planar"):
        mcdpr.Robot.load("planar-four").to_mjcf()


def test_the_control_core_flies_mujoco() -> None:
    seen = fly("paper-optimistic", "paper:table7", seed=1)
    assert seen["ratio_mean"] < 1.2, seen
    assert seen["mujoco_max_mm"] < 1.0, seen


def test_the_control_core_flies_mujoco_on_eight_cables() -> None:
    # A line: the demo's circle takes half a minute (python/studies/mujoco_flight.py).
    seen = fly("eight-cable", [0.1, -0.1, 0.65], seed=1)
    assert seen["ratio_mean"] < 1.2 and seen["ratio_max"] < 1.2, seen


def test_an_engine_that_fails_stops_the_run_with_its_words() -> None:
    robot = mcdpr.Robot.load("paper-optimistic")

    def broken(lengths: list[float], rates: list[float], seconds: float) -> object:
        assert len(lengths) == len(rates) == 4 and 0.0 < seconds <= 1e-3
        raise ArithmeticError("no more physics")

    with pytest.raises(mcdpr.RunError, match="no more physics"), robot.sim(seed=1) as session:
        session.fly(broken)  # type: ignore[arg-type]
        session.arm()

    def short(*_: object) -> object:
        return [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [1.0]

    with pytest.raises(mcdpr.RunError, match="1 tensions for 4"), robot.sim(seed=1) as session:
        session.fly(short)  # type: ignore[arg-type]
        session.step(0.1)
