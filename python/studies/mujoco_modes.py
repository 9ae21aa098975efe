"""Natural modes of MuJoCo's model against those of the statics: `python mujoco_modes.py --poses 100`.

MuJoCo's model is disturbed at rest coordinate by coordinate; forces over displacements are its stiffness, and its own
mass matrix with it gives the frequencies. Its swivelling pulleys and its winches have modes of their own; compared are
those that move the platform, by their share of the kinetic energy.
"""

from __future__ import annotations

import argparse

import mcdpr
import mujoco
import numpy as np
from mcdpr.mujoco_model import MujocoModel

PLATFORM_SHARE = 0.5
"""A mode with more than this share of its kinetic energy in the platform is the platform's."""
STEP = 1e-6
"""Displacement of a coordinate, m or rad: short against the stretch of a cable of EA 50 kN at 1 N, 20 um."""


def modes_hz(judge: MujocoModel, around_hz: float, step: float = STEP) -> np.ndarray:
    """Frequencies of the platform as it hangs, ascending."""
    model, data = judge.model, judge.data
    judge.settle(around_hz)
    rest, n = data.qpos.copy(), model.nv

    def force(k: int, by: float) -> np.ndarray:
        data.qpos[:], data.qvel[:] = rest, 0.0
        along = np.zeros(n)
        along[k] = by
        mujoco.mj_integratePos(model, data.qpos, along, 1.0)
        mujoco.mj_forward(model, data)
        return np.array(data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias)

    stiffness = -np.stack(
        [(force(k, step) - force(k, -step)) / (2 * step) for k in range(n)], axis=1
    )
    data.qpos[:], data.qvel[:] = rest, 0.0
    mujoco.mj_forward(model, data)
    mass = np.zeros((n, n))
    for k in range(n):
        column = np.zeros(n)
        mujoco.mj_mulM(model, data, column, np.eye(n)[k])
        mass[:, k] = column
    # M = L L^T: the squares are the eigenvalues of L^-1 K L^-T.
    inverse = np.linalg.inv(np.linalg.cholesky(mass))
    dynamic = inverse @ stiffness @ inverse.T
    squares, shapes = np.linalg.eigh(0.5 * (dynamic + dynamic.T))
    moves = inverse.T @ shapes
    of_platform = slice(judge._platform_dof, judge._platform_dof + 6)
    # Shapes have unit kinetic energy.
    share = np.einsum("ik,ij,jk->k", moves[of_platform], mass[of_platform, of_platform], moves[of_platform])
    return np.sqrt(np.maximum(squares[share > PLATFORM_SHARE], 0.0)) / (2 * np.pi)


def study(
    name: str, poses: int, seed: int, *, stiffer: float = 1.0, braked: bool = False
) -> np.ndarray:
    """Relative difference of the modes that the statics know, MuJoCo's over them less 1, at each pose.

    Args:
        stiffer: factor on the EA of every cable, in both models.
        braked: all lengths held, as behind closed brakes; else as the robot file says.

    Returns:
        (poses, k): k modes, ascending; NaN where MuJoCo has fewer of the platform.
    """
    robot = mcdpr.Robot.load(name)
    every = range(1, robot.cable_count + 1)
    edits: dict[str, object] = {
        f"cable.{i}.ea_n": stiffer * robot.values["cables"][i - 1]["ea_n"] for i in every
    }
    if braked:
        edits |= {f"cable.{i}.control": "position" for i in every}
    robot = robot.edited(edits)
    judge = MujocoModel(robot)
    low, high = np.array(robot._native.search_box_m)
    dice, off = np.random.default_rng(seed), []
    while len(off) < poses:
        try:
            ours = robot.statics(dice.uniform(low, high), "setpoint", tool=True)
        except mcdpr.KinematicsError:
            continue
        tension, limits = ours.tensions_n, robot.values["limits"]
        if not ours.stable or tension.min() < limits["tension_min_n"]:
            continue
        if tension.max() > limits["tension_max_n"]:
            continue
        judge.put(ours)
        known = ours.modes_hz[np.isfinite(ours.modes_hz)]
        # A stiffer cable stretches less: a displacement must not make it slack.
        theirs = np.full(len(known), np.nan)
        found = modes_hz(judge, float(ours.modes_hz[0]), STEP / stiffer)[: len(known)]
        theirs[: len(found)] = found
        off.append(theirs / known - 1.0)
    return np.array(off)


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--poses", type=int, default=20)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--robot", action="append")
    options.add_argument("--stiffer", type=float, default=1.0, help="factor on EA, in both models")
    options.add_argument("--braked", action="store_true", help="all lengths held")
    given = options.parse_args()
    for robot_name in given.robot or ["paper-optimistic", "eight-cable"]:
        seen = study(robot_name, given.poses, given.seed, stiffer=given.stiffer, braked=given.braked)
        worst = np.abs(seen).max(axis=1)
        inside = float(np.mean(worst < 0.02))
        print(
            f"{robot_name}: {seen.shape[1]} modes, greatest difference of a pose: median {np.median(worst):.4%}, "
            f"greatest {worst.max():.4%}, under 2 %: {inside:.0%}; mean of all {seen.mean():+.4%}"
        )
