"""Lengths of many poses from Python against the same lengths in Rust alone, in one run: `python speed.py`.

From Python: the whole call, with its checks and its arrays of poses and lengths. In Rust alone: the loop of the
kinematics crate's benchmark, over prepared poses, nothing kept: so many that the processor does not learn their branches.
They take turns, and the best time of each counts, so that other work of the computer does not. The loop in Rust has one
core. The call uses all; its time is given by the clock, and as processor time, which is that of one core.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import mcdpr
import numpy as np
from numpy.typing import NDArray

PREPARED = 65536
"""Poses of the loop in Rust; to prepare them is a hundredth of its time."""


def took_s(call: Callable[[], object]) -> NDArray[np.float64]:
    """Time of a call by the clock, and processor time, s."""
    began = np.array([time.perf_counter(), time.process_time()])
    call()
    return np.array([time.perf_counter(), time.process_time()]) - began


def compare(name: str, count: int, rounds: int, turned: bool) -> tuple[NDArray[np.float64], float]:
    """Best times of ``count`` lengths, s: from Python by the clock and of the processor, and in Rust."""
    robot = mcdpr.Robot.load(name)
    home = np.array(robot.values["tool"]["home_in_world_m"])
    dice = np.random.default_rng(1)
    place = home + dice.uniform(-0.05, 0.05, (count, 3))
    attitude = dice.uniform(-0.1, 0.1, (count, 3)) if turned else None
    python, rust = np.full(2, np.inf), np.inf
    for _ in range(rounds):
        python = np.minimum(python, took_s(lambda: robot.lengths(place, attitude)))
        alone = took_s(lambda: robot._native.lengths_alone(place[:PREPARED], count))
        rust = min(rust, float(alone[1]))
    return python, rust


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--robot", default="paper-optimistic")
    options.add_argument("--count", type=int, default=1_000_000)
    options.add_argument("--rounds", type=int, default=20)
    given = options.parse_args()
    for turned in (False, True):
        (clock_s, processor_s), rust_s = compare(given.robot, given.count, given.rounds, turned)
        what = "places and attitudes" if turned else "places"
        print(
            f"{given.robot}, {given.count} {what}: Python {clock_s:.4f} s ({processor_s:.4f} s of processor), "
            f"Rust {rust_s:.4f} s, ratio {clock_s / rust_s:.2f} ({processor_s / rust_s:.2f})"
        )
