"""Rest poses of MuJoCo against the statics of this project: `python mujoco_statics.py --poses 1000`.

Each pose is drawn from the robot's box; MuJoCo starts some millimetres off it and comes to rest.
"""

from __future__ import annotations

import argparse
import time

import mcdpr
import numpy as np
from mcdpr.mujoco_model import MujocoModel


def study(name: str, poses: int, seed: int) -> dict[str, float]:
    """Greatest differences over rest poses that the robot may take, by its own limits."""
    robot = mcdpr.Robot.load(name)
    judge = MujocoModel(robot)
    limits = robot.values["limits"]
    low, high = np.array(robot._native.search_box_m)
    dice = np.random.default_rng(seed)
    seen = {"poses": 0, "unsettled": 0, "position_mm": 0.0, "attitude_deg": 0.0, "tension_n": 0.0}
    while seen["poses"] < poses:
        place = dice.uniform(low, high)
        try:
            ours = robot.statics(place, "setpoint", tool=True)
        except mcdpr.KinematicsError:
            continue
        tension = ours.tensions_n
        if not ours.stable or tension.min() < limits["tension_min_n"]:
            continue
        if tension.max() > limits["tension_max_n"]:
            continue
        seen["poses"] += 1
        judge.put(ours, dice.uniform(-3e-3, 3e-3, 3))
        seen["unsettled"] += not judge.settle(float(ours.modes_hz[0]))
        off = {
            "position_mm": float(np.linalg.norm(judge.position_m - ours.position_m)) * 1e3,
            "attitude_deg": np.degrees(judge.turned_rad(ours.attitude_rad)),
            "tension_n": float(np.abs(judge.tensions_n - tension).max()),
        }
        for what, value in off.items():
            seen[what] = max(seen[what], float(value))
    return seen


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--poses", type=int, default=50)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--robot", action="append")
    given = options.parse_args()
    for robot_name in given.robot or ["paper-optimistic", "eight-cable"]:
        began = time.perf_counter()
        worst = study(robot_name, given.poses, given.seed)
        print(robot_name, worst, f"{time.perf_counter() - began:.0f} s")
