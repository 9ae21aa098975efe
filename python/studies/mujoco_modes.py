"""Natural modes of MuJoCo's model against those of the statics: `python mujoco_modes.py --poses 20`.

MuJoCo's model is disturbed at rest coordinate by coordinate; forces over displacements are its stiffness, and its own
mass matrix with it gives the frequencies.
"""

from __future__ import annotations

import argparse

import mcdpr
import mujoco
import numpy as np
from mcdpr.mujoco_model import MujocoModel


def modes_hz(judge: MujocoModel, around_hz: float) -> np.ndarray:
    """Frequencies of the model as it hangs, all of its freedoms, ascending."""
    model, data = judge.model, judge.data
    judge.settle(around_hz)
    rest, n = data.qpos.copy(), model.nv

    def force(k: int, by: float) -> np.ndarray:
        data.qpos[:], data.qvel[:] = rest, 0.0
        step = np.zeros(n)
        step[k] = by
        mujoco.mj_integratePos(model, data.qpos, step, 1.0)
        mujoco.mj_forward(model, data)
        return np.array(data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias)

    h = 1e-6
    stiffness = -np.stack([(force(k, h) - force(k, -h)) / (2 * h) for k in range(n)], axis=1)
    data.qpos[:], data.qvel[:] = rest, 0.0
    mujoco.mj_forward(model, data)
    mass = np.zeros((n, n))
    for k in range(n):
        column = np.zeros(n)
        mujoco.mj_mulM(model, data, column, np.eye(n)[k])
        mass[:, k] = column
    squares = np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real
    return np.sort(np.sqrt(np.maximum(squares, 0.0))) / (2 * np.pi)


def study(name: str, poses: int, seed: int) -> np.ndarray:
    """Greatest relative difference of the modes that the statics know, at each pose."""
    robot = mcdpr.Robot.load(name)
    if robot.cable_count > 4:
        # With all lengths held, as behind closed brakes. With two cables held by tension the statics and MuJoCo differ
        # by half: not explained yet.
        robot = robot.edited({f"cable.{i}.control": "position" for i in range(1, robot.cable_count + 1)})
    judge = MujocoModel(robot)
    low, high = np.array(robot._native.search_box_m)
    dice, worst = np.random.default_rng(seed), []
    while len(worst) < poses:
        try:
            ours = robot.statics(dice.uniform(low, high), tool=True)
        except mcdpr.KinematicsError:
            continue
        tension, limits = ours.tensions_n, robot.values["limits"]
        if not ours.stable or tension.min() < limits["tension_min_n"]:
            continue
        if tension.max() > limits["tension_max_n"]:
            continue
        judge.put(ours)
        theirs = modes_hz(judge, float(ours.modes_hz[0]))
        known = ours.modes_hz[np.isfinite(ours.modes_hz)]
        # The statics' modes are the slowest of MuJoCo's, which has winches and pulleys that turn as well.
        worst.append(float(np.abs(theirs[: len(known)] / known - 1.0).max()))
    return np.array(worst)


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--poses", type=int, default=20)
    options.add_argument("--seed", type=int, default=1)
    given = options.parse_args()
    for robot_name in ("paper-table5", "eight-cable"):
        off = study(robot_name, given.poses, given.seed)
        inside = float(np.mean(off < 0.02))
        print(f"{robot_name}: median {np.median(off):.4%}, greatest {off.max():.4%}, under 2 %: {inside:.0%}")
