"""The mathematics: the program's numbers to the last bit, any leading shape, refusals with place."""

from __future__ import annotations

import time

import mcdpr
import numpy as np
import pytest
from conftest import ROBOTS, program


def poses(robot: mcdpr.Robot, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    dice = np.random.default_rng(seed)
    low, high = np.array(robot._native.search_box_m)
    middle, half = (low + high) / 2, (high - low) / 2
    return middle + 0.6 * half * dice.uniform(-1, 1, (count, 3)), dice.uniform(-0.3, 0.3, (count, 3))


@pytest.mark.parametrize("name", ROBOTS)
def test_inverse_equals_the_program(name: str) -> None:
    robot = mcdpr.Robot.load(name)
    position, attitude = poses(robot, 60, 1)
    lines = [
        {"position_m": p.tolist(), "attitude_rad": a.tolist()} for p, a in zip(position, attitude)
    ]
    for tool in (False, True):
        words = ["ik", "--batch", "--robot", name, "--calibration", "none"]
        answers = program(*words, *(["--tool"] if tool else []), lines=lines)
        found = robot.ik(position, attitude, tool=tool, on_error="nan")
        jacobian = robot.jacobian(position, attitude, tool=tool, on_error="nan")
        for k, answer in enumerate(answers):
            if "error" in answer:
                assert np.isnan(found.lengths_m[k]).all()
                with pytest.raises(mcdpr.KinematicsError) as refused:
                    robot.ik(position[k], attitude[k], tool=tool)
                assert refused.value.message == answer["error"]
                continue
            assert found.lengths_m[k].tolist() == answer["lengths_m"]
            assert found.wrap_rad[k].tolist() == answer["wrap_rad"]
            assert found.directions[k].tolist() == answer["directions"]
            assert jacobian[k].tolist() == answer["jacobian"]
        assert np.array_equal(
            robot.lengths(position, attitude, tool=tool, on_error="nan"),
            found.lengths_m,
            equal_nan=True,
        )


@pytest.mark.parametrize("name", ROBOTS)
def test_statics_equal_the_program(name: str) -> None:
    robot = mcdpr.Robot.load(name)
    position, _ = poses(robot, 60, 2)
    lines = [{"position_m": p.tolist()} for p in position]
    answers = program("statics", "--batch", "--robot", name, "--tool", lines=lines)
    found = robot.statics(position, tool=True, on_error="nan")
    hanging = 0
    for k, answer in enumerate(answers):
        if "error" in answer:
            with pytest.raises(mcdpr.KinematicsError) as refused:
                robot.statics(position[k], tool=True)
            assert refused.value.message == answer["error"]
            assert refused.value.kind
            continue
        hanging += 1
        assert found.tensions_n[k].tolist() == answer["tensions_n"]
        assert found.lengths_m[k].tolist() == answer["lengths_m"]
        assert found.attitude_rad[k].tolist() == answer["attitude_rad"]
        assert bool(found.stable[k]) == answer["stable"]
        modes = found.modes_hz[k]
        assert modes[~np.isnan(modes)].tolist() == answer["modes_hz"]
        # Another way to the same balance: wrenches of the cables against the weight.
        weight = robot.values["platform"]["mass_kg"] * 9.80665
        matrix = robot.structure_matrix(found.position_m[k], found.attitude_rad[k])
        assert np.abs((matrix @ found.tensions_n[k])[:3] - [0, 0, weight]).max() < 1e-6
    assert hanging >= 5


def test_forward_solvers_equal_the_program_and_come_back() -> None:
    robot = mcdpr.Robot.load("paper-table5")
    position, attitude = poses(robot, 30, 3)
    lengths = robot.lengths(position, attitude)
    found = robot.fk(lengths, attitude)
    assert np.abs(found.position_m - position).max() < 1e-9
    lines = [
        {"lengths_m": length.tolist(), "attitude_rad": a.tolist()}
        for length, a in zip(lengths, attitude)
    ]
    answers = program("fk", "--batch", "--robot", "paper-table5", lines=lines)
    assert found.position_m.tolist() == [answer["position_m"] for answer in answers]
    assert found.iterations.tolist() == [answer["iterations"] for answer in answers]
    yaw = robot.fk(lengths, attitude, free="yaw")
    assert np.abs(yaw.attitude_rad - attitude).max() < 1e-7
    eight = mcdpr.Robot.load("eight-cable")
    position, attitude = poses(eight, 20, 4)
    every = eight.fk(eight.lengths(position, attitude))
    assert np.abs(every.position_m - position).max() < 1e-8
    assert np.abs(every.attitude_rad - attitude).max() < 1e-8


def test_the_pose_at_rest_equals_the_program() -> None:
    robot = mcdpr.Robot.load("paper-table5")
    hanging = robot.statics([[0.30, 0.05, -0.2], [0.35, -0.1, -0.3]], {4: 10.0})
    found = robot.fk_static(hanging.lengths_m[:, :3], {4: 10.0})
    assert np.abs(found.position_m - hanging.position_m).max() < 1e-8
    lines = [
        {"lengths_m": length.tolist(), "tensions_n": {"4": 10.0}}
        for length in hanging.lengths_m[:, :3]
    ]
    answers = program("fk", "--static", "--batch", lines=lines)
    assert found.position_m.tolist() == [answer["position_m"] for answer in answers]
    assert found.tensions_n.tolist() == [answer["tensions_n"] for answer in answers]
    gaps = np.where(np.arange(4) < 3, hanging.lengths_m, np.nan)
    assert np.array_equal(robot.fk_static(gaps, {4: 10.0}).position_m, found.position_m)


def test_the_work_space_equals_the_program() -> None:
    for name, extra in (("paper-table5", []), ("eight-cable", ["--test", "wrench"])):
        answer = program("workspace", "--step", "100", "--robot", name, *extra, "--json")
        found = mcdpr.Robot.load(name).workspace(0.1)
        assert list(found.verdicts.shape) == answer["grid"]
        assert int(found.feasible.sum()) == answer["feasible"] > 0


def test_places_have_the_tension_that_plans_choose() -> None:
    robot = mcdpr.Robot.load("lab-fast")
    place = [0.255, -0.105, -0.18]
    planned, constant = robot.statics(place, tool=True), robot.statics(place, "setpoint", tool=True)
    assert constant.tensions_n[3] == robot.values["tension"]["setpoint_n"]
    # No other tension makes the smallest tension greater.
    for more in (-0.5, 0.5):
        other = robot.statics(place, {4: planned.tensions_n[3] + more}, tool=True)
        assert other.tensions_n.min() < planned.tensions_n.min()
    answer = program("statics", *(f"{v}m" for v in place), "--tool", "--robot", "lab-fast", "--json")
    assert planned.tensions_n.tolist() == answer["tensions_n"]
    space, narrow = robot.workspace(0.1), robot.workspace(0.1, tensions_n="setpoint")
    assert int(space.feasible.sum()) > int(narrow.feasible.sum()) > 0
    with pytest.raises(mcdpr.InputError):
        robot.statics(place, "as you like", tool=True)  # type: ignore[arg-type]


def test_tensions_balance_a_load() -> None:
    robot = mcdpr.Robot.load("eight-cable")
    load = np.array([3.0, -2.0, 1.0, 0.1, 0.0, -0.1])
    place = [0.1, -0.1, 0.8]
    for goal in ("middle", "minimum_norm", np.full(8, 20.0)):
        tensions = robot.distribute(place, wrench=load, goal=goal)
        weight = np.array([0, 0, -robot.values["platform"]["mass_kg"] * 9.80665, 0, 0, 0])
        left = robot.structure_matrix(place) @ tensions + load + weight
        assert np.abs(left).max() < 1e-6
    with pytest.raises(mcdpr.KinematicsError) as refused:
        robot.distribute(place, wrench=[500, 0, 0, 0, 0, 0])
    assert refused.value.kind in ("OutsideTensionLimits", "WrenchNotBalanced")


def test_the_jacobian_is_the_derivative_of_the_lengths() -> None:
    robot = mcdpr.Robot.load("paper-table5")
    place, turned, h = np.array([0.3, 0.02, -0.2]), np.array([0.1, -0.05, 0.2]), 1e-6
    jacobian = robot.jacobian(place, turned, by="euler")
    for k in range(6):
        step = np.eye(6)[k] * h
        ahead = robot.lengths(place + step[:3], turned + step[3:])
        behind = robot.lengths(place - step[:3], turned - step[3:])
        assert np.abs((ahead - behind) / (2 * h) - jacobian[:, k]).max() < 1e-7


def test_any_leading_shape() -> None:
    robot = mcdpr.Robot.load("paper-table5")
    one = robot.ik([0.3, 0.0, -0.2])
    assert one.lengths_m.shape == (4,) and one.directions.shape == (4, 3)
    many = robot.ik(np.broadcast_to([0.3, 0.0, -0.2], (2, 5, 3)), np.zeros((5, 3)))
    assert many.lengths_m.shape == (2, 5, 4) and many.tangent_points_m.shape == (2, 5, 4, 3)
    assert np.array_equal(many.lengths_m[1, 4], one.lengths_m)
    assert robot.statics(np.zeros((0, 3))).stiffness.shape == (0, 6, 6)
    turned = np.asfortranarray(np.random.default_rng(5).uniform(0.2, 0.4, (3, 4)).T)
    assert np.array_equal(robot.lengths(turned), robot.lengths(np.ascontiguousarray(turned)))


def test_bad_arrays_are_refused_with_what_and_where() -> None:
    robot = mcdpr.Robot.load("paper-table5")
    bad = np.full((2, 3, 3), 0.2)
    bad[1, 2, 0] = np.nan
    for call in (robot.ik, robot.statics, robot.jacobian, robot.lengths, robot.distribute):
        with pytest.raises(mcdpr.InputError, match=r"position_m\[1, 2, 0\] is nan") as refused:
            call(bad)
        assert refused.value.index == (1, 2, 0) and isinstance(refused.value, ValueError)
        with pytest.raises(mcdpr.InputError, match=r"shape \(4, 2\).*3 entries"):
            call(np.zeros((4, 2)))
        with pytest.raises(mcdpr.InputError, match="not an array of numbers"):
            call([[1, 2], [3]])
    with pytest.raises(mcdpr.InputError, match=r"position_m \(4, 3\), attitude_rad \(5, 3\)"):
        robot.ik(np.zeros((4, 3)), np.zeros((5, 3)))
    with pytest.raises(mcdpr.InputError, match="there is no cable 5"):
        robot.statics([0.3, 0, -0.2], {5: 10.0})
    with pytest.raises(mcdpr.InputError, match="on_error"):
        robot.ik([0.3, 0, -0.2], on_error="ignore")  # type: ignore[arg-type]
    with pytest.raises(mcdpr.InputError, match=r"lengths_m: shape \(5,\)"):
        robot.fk_static(np.ones(5), {4: 10.0})


def test_a_refused_pose_of_an_array_is_named() -> None:
    robot = mcdpr.Robot.load("paper-table5")
    places = np.broadcast_to([0.3, 0.0, -0.2], (2, 3, 3)).copy()
    places[1, 1] = [5.0, 0.0, -0.2]
    with pytest.raises(mcdpr.KinematicsError) as refused:
        robot.statics(places)
    assert refused.value.index == (1, 1)
    assert str(refused.value).startswith("[1, 1]: cable ")
    kept = robot.statics(places, on_error="nan")
    assert np.isnan(kept.tensions_n[1, 1]).all() and np.isfinite(kept.tensions_n[0]).all()
    with pytest.raises(mcdpr.KinematicsError, match="planar"):
        mcdpr.Robot.load("planar-four").statics([0.5, 0.0, 0.5])


@pytest.mark.parametrize("turned", [False, True])
def test_a_large_batch_on_all_processors_equals_its_rows(turned: bool) -> None:
    robot = mcdpr.Robot.load("paper-table5")
    place, attitude = poses(robot, 20_001, 9)
    cable = robot.values["cables"][0]
    inside = np.subtract(cable["anchor_in_world_m"], cable["attachment_in_platform_m"])
    for index in (19_000, 3_000):
        place[index], attitude[index] = inside, 0.0
    angles = attitude if turned else None
    found = robot.lengths(place, angles, on_error="nan")
    for k in (0, 2_999, 3_000, 10_000, 10_001, 18_999, 19_000, 20_000):
        one = robot.lengths(place[k], None if angles is None else angles[k], on_error="nan")
        assert np.array_equal(found[k], one, equal_nan=True)
    assert np.flatnonzero(np.isnan(found[:, 0])).tolist() == [3_000, 19_000]
    with pytest.raises(mcdpr.KinematicsError) as refused:
        robot.lengths(place, angles)
    assert refused.value.index == (3_000,)


def test_the_lock_is_released() -> None:
    """Another thread goes on while a long call is under way."""
    import threading

    robot = mcdpr.Robot.load("paper-table5")
    places = np.broadcast_to([0.3, 0.0, -0.2], (20_000, 3))
    seen: list[float] = []
    over = threading.Event()

    def look() -> None:
        while not over.is_set():
            seen.append(time.perf_counter())
            over.wait(0.001)

    thread = threading.Thread(target=look)
    thread.start()
    began = time.perf_counter()
    robot.statics(places)
    ended = time.perf_counter()
    over.set()
    thread.join()
    assert sum(began < at < ended for at in seen) >= 3


def test_stiffness_and_modes_of_many_places() -> None:
    robot = mcdpr.Robot.load("paper-table5")
    places = np.array([[[0.30, 0.05, -0.2], [0.35, -0.1, -0.3]]])
    stiffness, modes = robot.stiffness(places), robot.modes(places)
    assert stiffness.shape == (1, 2, 6, 6) and modes.shape == (1, 2, 6)
    assert np.array_equal(modes[0, 1], robot.statics(places[0, 1]).modes_hz, equal_nan=True)
    # Another way: a force moves the tool as the inverse of the stiffness says.
    assert np.allclose(stiffness, np.swapaxes(stiffness, -1, -2), rtol=1e-6, atol=1e-6)
    assert (np.linalg.eigvalsh(stiffness) > 0).all()


def test_the_import_is_quick() -> None:
    import subprocess
    import sys

    words = "import time; t = time.perf_counter(); import mcdpr; print(time.perf_counter() - t)"
    took = [float(subprocess.check_output([sys.executable, "-c", words])) for _ in range(3)]
    # numpy comes with the first robot.
    assert min(took) < 0.2
