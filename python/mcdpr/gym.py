"""Gymnasium environments: a tool that shall reach a place, on a machine that is never quite its file.

``gymnasium.make("mcdpr/Reach-v0")`` after ``import mcdpr.gym``; ``make_vec`` steps many machines in one call.
Plant, drives, bus and winches are the simulator's; no board and no control core are between, so that a step
takes little time. Episodes end when the tool leaves the robot's box, a cable is torn at one and a half times
its limit, or the platform gets where the physics ends.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Literal

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, VectorEnv

from . import _mcdpr
from .errors import InputError, KinematicsError
from .robot import Mismatch, Robot

Floats = npt.NDArray[np.float32]
Action = Literal["velocity", "tensions"]

STEP_S = 0.02
"""Duration of a step, s: actions come at 50 Hz."""
AT_TARGET_M = 2e-3
"""Nearer than this is there, m."""


class _Task:
    """What one machine and many have in common: spaces, places, rewards."""

    def __init__(
        self,
        robot: Robot | str,
        action: Action,
        mismatch: Mismatch | Mapping[str, Any],
        reach_m: float,
        count: int,
    ) -> None:
        self.robot = Robot.load(robot) if isinstance(robot, str) else robot
        self.action: Action = action
        if not 0.0 < reach_m <= 10.0:
            raise InputError(f"reach_m: {reach_m}; it is 0 to 10 m")
        self.reach_m = reach_m
        values = self.robot.values
        limits = values["limits"]
        n = self.robot.cable_count
        self.box = np.array(self.robot._native.search_box_m)
        self.home_m = np.array(values["tool"]["home_in_world_m"], dtype=float)
        self.tension_n = (float(limits["tension_min_n"]), float(limits["tension_max_n"]))
        if action == "velocity":
            speed = np.full(3, limits["speed_mps"], dtype=np.float32)
            self.actions = gymnasium.spaces.Box(-speed, speed, dtype=np.float32)
        else:
            low = np.zeros(n, dtype=np.float32)
            high = np.full(n, self.tension_n[1], dtype=np.float32)
            self.actions = gymnasium.spaces.Box(low, high, dtype=np.float32)
        words = mismatch if isinstance(mismatch, str) else json.dumps(dict(mismatch))
        # An action that is not known gets its refusal from there.
        within = (float(self.actions.low[0]), float(self.actions.high[0]))
        self.native = _mcdpr.Machines(
            self.robot._native, count, action, words, within, reach_m, AT_TARGET_M
        )
        # tool (3), attitude (3), velocity (3), turning (3), tensions (n), paid out (n), target - tool (3)
        self.observations = gymnasium.spaces.Box(-np.inf, np.inf, (15 + 2 * n,), dtype=np.float32)

    def place(self, dice: np.random.Generator) -> npt.NDArray[np.float64]:
        """A place near home where the robot may hang by its own limits."""
        middle = np.clip(self.home_m, self.box[0] + self.reach_m, self.box[1] - self.reach_m)
        low = np.maximum(self.box[0], middle - self.reach_m)
        high = np.minimum(self.box[1], middle + self.reach_m)
        low = np.minimum(low, high)
        for _ in range(200):
            place: npt.NDArray[np.float64] = dice.uniform(low, high)
            try:
                found = self.robot.statics(place, "setpoint", tool=True)
            except KinematicsError:
                continue
            tensions = found.tensions_n
            inside = self.tension_n[0] <= tensions.min() and tensions.max() <= self.tension_n[1]
            if inside and bool(found.stable):
                return place
        raise InputError(f"reach_m: no place within {self.reach_m} m of home where the robot can hang")

    def begin(self, index: int, dice: np.random.Generator) -> npt.NDArray[np.float64]:
        """A new machine at rest somewhere; gives where its tool shall go."""
        start = self.place(dice)
        seed = int(dice.integers(0, 2**63))
        target = self.place(dice)
        self.native.reset(index, seed, start.tolist(), target.tolist())
        return target


class Reach(gymnasium.Env[Floats, Floats]):
    """One machine whose tool shall reach a place and stay there.

    Args:
        robot: a robot, or a file or built-in name.
        action: "velocity", of the tool, world, m/s (3,), followed by all winches in position mode, as far
            as the robot may hang there; or "tensions", N (n,), the pull of each motor at its cable.
        mismatch: how far each machine is from its file; drawn anew at every reset.
        reach_m: start and target are this near home, in each axis, m.

    An observation (15 + 2 n,) has the tool's place (m), the platform's attitude (roll, pitch, yaw, rad),
    velocity (m/s) and turning (rad/s), tensions at the winches (N), cable paid out since the start (m), and
    the way from tool to target (m). The reward is the negative distance over ``reach_m``, one more at the
    target, and -10 when the robot is lost. An episode has no end of its own but that: ``make`` cuts it at 500
    steps. The same seed gives the same episode bit by bit.
    """

    metadata: dict[str, Any] = {"render_modes": [], "render_fps": 50}

    def __init__(
        self,
        robot: Robot | str = "paper-optimistic",
        action: Action = "velocity",
        mismatch: Mismatch | Mapping[str, Any] = "realistic",
        reach_m: float = 0.05,
        render_mode: None = None,
    ) -> None:
        self._task = _Task(robot, action, mismatch, reach_m, 1)
        self.action_space = self._task.actions
        self.observation_space = self._task.observations
        self.render_mode = render_mode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """A new machine, a new start, a new target."""
        super().reset(seed=seed)
        target = self._task.begin(0, self.np_random)
        return self._task.native.seen()[0][0], {"target_m": target}

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Lets 20 ms pass under an action; one that is out of its limits is cut to them."""
        native = self._task.native
        native.step(_asked(np.asarray(action)[None], self._task), STEP_S)
        seen, rewards, lost, there, planned = native.seen()
        info = {"at_target": bool(there[0]), "planned_tool_m": planned[0]}
        return seen[0], float(rewards[0]), bool(lost[0]), False, info


class ReachVector(VectorEnv[Floats, Floats, Any]):
    """Many machines in one call; arguments as :class:`Reach`.

    A machine that is lost or has had ``max_episode_steps`` begins anew in the step after.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}

    def __init__(
        self,
        num_envs: int = 1,
        robot: Robot | str = "paper-optimistic",
        action: Action = "velocity",
        mismatch: Mismatch | Mapping[str, Any] = "realistic",
        reach_m: float = 0.05,
        max_episode_steps: int = 500,
        render_mode: None = None,
    ) -> None:
        self._task = _Task(robot, action, mismatch, reach_m, num_envs)
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.single_action_space = self._task.actions
        self.single_observation_space = self._task.observations
        self.action_space = gymnasium.vector.utils.batch_space(self._task.actions, num_envs)
        self.observation_space = gymnasium.vector.utils.batch_space(
            self._task.observations, num_envs
        )
        self._most = max_episode_steps
        self._dice: list[np.random.Generator] = []
        self._targets = np.zeros((num_envs, 3))
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._over = np.zeros(num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """New machines; machine k has ``seed + k``, or ``seed[k]``."""
        seeds: list[int | None] = [None] * self.num_envs
        if isinstance(seed, list):
            seeds = seed
        elif seed is not None:
            seeds = [seed + k for k in range(self.num_envs)]
        if seed is not None or not self._dice:
            self._dice = [gymnasium.utils.seeding.np_random(own)[0] for own in seeds]
        for k in range(self.num_envs):
            self._begin(k)
        return self._task.native.seen()[0], {"target_m": self._targets.copy()}

    def _begin(self, k: int) -> None:
        self._targets[k] = self._task.begin(k, self._dice[k])
        self._steps[k], self._over[k] = 0, False

    def step(
        self, actions: Floats
    ) -> tuple[Floats, npt.NDArray[np.float64], npt.NDArray[np.bool_], npt.NDArray[np.bool_], dict[str, Any]]:
        """20 ms of every machine; actions (m, 3) or (m, n)."""
        over = self._over.copy()
        self._task.native.step(_asked(actions, self._task), STEP_S)
        for k in np.flatnonzero(over):
            self._begin(int(k))
        seen, rewards, lost, there, planned = self._task.native.seen()
        rewards[over] = 0.0
        self._steps += 1
        cut = ~lost & ~over & (self._steps >= self._most)
        lost &= ~over
        self._over = lost | cut
        info = {"at_target": there, "planned_tool_m": planned}
        return seen, rewards, lost, cut, info


def _asked(actions: npt.ArrayLike, task: _Task) -> npt.NDArray[np.float64]:
    asked = np.asarray(actions, dtype=np.float64)
    width = task.actions.shape[0]
    if asked.ndim != 2 or asked.shape[1] != width:
        raise InputError(f"action: shape {asked.shape[1:]}, but it must be ({width},)")
    return asked


gymnasium.register(
    id="mcdpr/Reach-v0",
    entry_point="mcdpr.gym:Reach",
    vector_entry_point="mcdpr.gym:ReachVector",
    max_episode_steps=500,
)
