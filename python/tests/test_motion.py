"""Plans and sessions: the program's numbers, faults as exceptions, the same over a port."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import mcdpr
import numpy as np
import pytest
from conftest import PROGRAM, program, refusal


def test_a_plan_equals_the_program_s(tmp_path: Path) -> None:
    robot = mcdpr.Robot.load("paper-table5")
    plan = robot.plan("paper:table7")
    answer = program("plan", "paper:table7", "--json", cwd=tmp_path)
    assert plan.duration_s == answer["duration_s"]
    assert plan.extremes == answer["verdict"]
    assert len(plan.knots.time_s) == answer["knots"]
    picture = plan.png()
    assert picture.startswith(b"\x89PNG\r\n\x1a\n") and picture.endswith(b"IEND\xaeB`\x82")
    states = plan.states(0.05)
    assert states.time_s[0] == 0.0 and states.time_s[-1] == plan.duration_s
    assert states.tensions_n.shape == (len(states.time_s), 4)
    assert states.tensions_n.min() >= plan.extremes["tension_min_n"][0] - 1.0
    # The states are equilibria, interpolated between places: lengths at their poses are their own.
    lengths = robot.lengths(states.position_m, states.attitude_rad)
    assert np.abs(lengths - states.lengths_m).max() < 1e-7
    # Knots are the paid-out lengths, to the 0.1 um of the wire.
    at_knots = plan.at(plan.knots.time_s)
    assert np.abs(at_knots.paid_out_m - plan.knots.lengths_m).max() < 1e-5


def test_a_refused_plan_has_the_program_s_words_and_its_numbers(tmp_path: Path) -> None:
    robot = mcdpr.Robot.load("paper-table5").edited({"limits.tilt_max_deg": 1.0})
    file = tmp_path / "strict.toml"
    robot.save(file)
    with pytest.raises(mcdpr.PlanError) as refused:
        robot.plan("paper:table7")
    error = refused.value
    assert error.code == "mcdpr::plan::limit" and error.unit == "deg"
    assert error.limit == pytest.approx(1.0) and error.value > 1.0 and len(error.tool_m) == 3
    said = refusal("plan", "paper:table7", "--robot", str(file), cwd=tmp_path)
    assert " ".join(error.message.split()) in said
    with pytest.raises(mcdpr.TaskError, match="there is no task nonsense"):
        robot.plan("nonsense")
    with pytest.raises(mcdpr.PlanError):
        robot.plan([9.0, 0.0, 0.0])
    with pytest.raises(mcdpr.InputError, match=r"task\[2\] is nan"):
        robot.plan([0.3, 0.0, float("nan")])


def test_a_simulated_run_is_the_program_s_to_the_last_bit(tmp_path: Path) -> None:
    answer = program("demo", "--seed", "5", "--json", "--record", str(tmp_path / "run"))
    with mcdpr.Robot.load("paper-table5").sim(seed=5) as robot:
        run = robot.run("paper:table7")
    for figure in ("path_error_m", "cable_length_error_m", "tension_error_n"):
        assert run.figures[figure] == answer[figure]
    # The figure again, by other means.
    moving = (run.truth["path_s"] > 0.0) & (run.truth["path_s"] <= run.plan.duration_s)
    wanted = run.plan.at(run.truth["path_s"][moving]).tool_m
    errors = np.linalg.norm(run.truth["tool_m"][moving] - wanted, axis=1)
    assert errors.max() == pytest.approx(run.figures["path_error_m"]["max"], rel=0.05)
    assert run.measured["lengths_m"].shape == run.measured["tensions_n"].shape


def test_the_same_seed_is_the_same_machine() -> None:
    robot = mcdpr.Robot.load("lab-direct")

    def made(seed: int) -> Any:
        with robot.sim(seed=seed) as session:
            session.jog([0.0, 0.02, 0.0], 0.4)
            session.step(0.2)
            return session.truth

    one, same, other = made(7), made(7), made(8)
    for key, value in one.items():
        assert np.array_equal(value, same[key]), key
    assert not np.array_equal(one["tool_m"], other["tool_m"])


def test_a_fault_is_an_exception_and_the_session_goes_on() -> None:
    with mcdpr.Robot.load("paper-table5").sim(seed=2) as robot:
        robot.move([0.30, 0.0, -0.2])
        before = robot.truth["tool_m"]
        assert np.abs(before - [0.30, 0.0, -0.2]).max() < 2e-3
        robot.inject("S2:2")
        with pytest.raises(mcdpr.FaultError) as stopped:
            robot.move([0.30, 0.1, -0.2])
        assert (stopped.value.fault, stopped.value.cable) == ("S2", 2)
        assert "encoder stuck" in stopped.value.message
        robot.step(3.0)
        assert robot.status["brakes_open"] == 0
        assert "S2" in (robot.clear() or "")
        assert robot.status["fault"] is None
        with pytest.raises(mcdpr.ScenarioError, match="there is no fault Q9"):
            robot.inject("Q9")
    with pytest.raises(mcdpr.RunError, match="the session has ended"):
        robot.step(0.1)


def test_a_load_tilts_the_platform_as_the_statics_say() -> None:
    robot = mcdpr.Robot.load("paper-table5")
    with robot.sim(seed=1, mismatch="exact") as session:
        session.arm()
        session.step(1.0)
        rest = session.truth["position_m"].copy()
        session.load([0.3, 0.0, 0.0])
        session.step(1.0)
        moved = session.truth["position_m"] - rest
    assert 1e-4 < moved[0] < 0.1
    with robot.sim(seed=1, mismatch={"mass": 0.0, **exact()}) as session:
        assert session.status["state"] == "Disarmed"
    with pytest.raises(mcdpr.InputError, match="mismatch"):
        robot.sim(mismatch="odd")  # type: ignore[arg-type]


def exact() -> dict[str, Any]:
    keys = ("anchors_m", "attachments_m", "center_of_mass_m", "mass", "ea", "sensor_gain")
    gears = dict.fromkeys(("friction", "loss", "play", "stiffness"), 0.0)
    return {**dict.fromkeys((*keys, "bandwidth", "pulley_loss"), 0.0), "gears": gears}


def test_the_same_calls_move_a_robot_behind_a_port(tmp_path: Path) -> None:
    scale = "0.5"
    words = [PROGRAM, "sim", "--pty", "--seed", "4", "--time-scale", scale]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=tmp_path) as board:
        try:
            assert board.stdout is not None
            port = next(w for line in board.stdout for w in line.split() if "/dev/" in w)
            robot = mcdpr.Robot.load("paper-table5")
            home = robot.values["tool"]["home_in_world_m"]
            with robot.connect(port, home, time_scale=float(scale)) as session:
                run = session.move(np.array(home) + [0.0, 0.004, 0.0])
                assert session.status["state"] == "Holding"
                assert len(run.measured["tick"]) > 100 and len(run.truth["tick"]) == 0
                assert run.figures["path_error_m"] is None
                with pytest.raises(mcdpr.RunError, match="only a simulated robot"):
                    session.inject("S2:1")
                session.disarm()
        finally:
            board.terminate()
    with pytest.raises(mcdpr.RunError, match="there is no serial port"):
        mcdpr.Robot.load("paper-table5").connect("/dev/no-such-port")
