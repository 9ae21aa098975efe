"""The control core flies MuJoCo: a circle and a line, on the simulator's own platform and cables and on
MuJoCo's, all else being equal. `python mujoco_flight.py --robot eight-cable`
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import mcdpr
from mcdpr.mujoco_model import MujocoPlant

TASKS: dict[str, list[Any]] = {
    "paper-optimistic": ["paper:table7", "paper:table8"],
    # What `mcdpr demo` chooses (a circle, then tilts and turns), and a line of 0.36 m.
    "eight-cable": ["fitting", [0.25, -0.2, 0.55]],
}


def fly(name: str, task: Any, seed: int) -> dict[str, float]:
    """Path errors (mm) of a task on both, by the truth of each."""
    robot = mcdpr.Robot.load(name)
    seen: dict[str, float] = {}
    for plant in ("own", "mujoco"):
        began = time.perf_counter()
        with robot.sim(seed=seed, mismatch="exact") as session:
            if plant == "mujoco":
                session.fly(MujocoPlant(robot))
            run = session.run(task)
        for what in ("mean", "max"):
            seen[f"{plant}_{what}_mm"] = run.figures["path_error_m"][what] * 1e3
        seen[f"{plant}_tension_mean_n"] = run.figures["tension_error_n"]["mean_abs"]
        seen[f"{plant}_took_s"] = time.perf_counter() - began
    seen["ratio_mean"] = seen["mujoco_mean_mm"] / seen["own_mean_mm"]
    seen["ratio_max"] = seen["mujoco_max_mm"] / seen["own_max_mm"]
    return seen


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--robot", action="append")
    options.add_argument("--seed", type=int, default=1)
    given = options.parse_args()
    for robot_name in given.robot or list(TASKS):
        for what in TASKS.get(robot_name, ["fitting"]):
            seen = fly(robot_name, what, given.seed)
            words = {key: float(f"{value:.4g}") for key, value in seen.items()}
            print(robot_name, what, json.dumps(words), flush=True)
