"""Plans as arrays."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Union

import numpy as np
import numpy.typing as npt

from . import _mcdpr
from ._arrays import Array, Numbers, numbers, vector
from .errors import InputError

Task = Union[str, "os.PathLike[str]", Sequence[float], npt.NDArray[np.float64]]
"""A built-in task, a task file, its text (``"text:..."``), or a place of the tool (3,), m."""


def what_of(task: Task) -> str | list[float]:
    """A task as the native half takes it."""
    if isinstance(task, (str, os.PathLike)):
        return os.fspath(task)
    return vector("task", task, 3, "x, y, z of the tool")


@dataclass(frozen=True)
class States:
    """Expected states along a plan; t times, n cables."""

    time_s: Array
    """(t,)"""
    tool_m: Array
    """(t, 3): tool, world, m."""
    position_m: Array
    """(t, 3): platform's origin, world, m."""
    attitude_rad: Array
    """(t, 3): roll, pitch, yaw, rad."""
    tensions_n: Array
    """(t, n), N."""
    lengths_m: Array
    """(t, n): geometric, m."""
    paid_out_m: Array
    """(t, n): what the drums have paid out, m."""
    speed_mps: Array
    """(t,): of the tool along its path, m/s."""


@dataclass(frozen=True)
class Knots:
    """What goes to the board: clamped cubic splines; k knots, n cables."""

    time_s: Array
    """(k,)"""
    lengths_m: Array
    """(k, n): paid out, m."""
    speeds_mps: Array
    """(k, n), m/s."""
    tensions_n: Array
    """(k, n): expected, or set-point, N."""


class Plan:
    """A motion that breaks no limit."""

    __slots__ = ("_native",)

    def __init__(self, native: _mcdpr.Plan) -> None:
        self._native = native

    @property
    def name(self) -> str:
        """The task's name."""
        return self._native.name

    @property
    def duration_s(self) -> float:
        """Duration, s."""
        return self._native.duration_s

    @property
    def extremes(self) -> dict[str, Any]:
        """How close it comes to every limit, SI: the ``verdict`` of ``mcdpr plan --json``."""
        return self._native.extremes()

    def states(self, step_s: float = 0.01) -> States:
        """Expected states at equal times, both ends included."""
        if not step_s > 0.0 or self.duration_s / step_s > 1e7:
            raise InputError(f"step_s: {step_s}; it must be positive and give 1e7 states at most")
        count = int(np.ceil(self.duration_s / step_s))
        times = np.arange(count + 1) * step_s
        return self.at(np.append(times[times < self.duration_s], self.duration_s))

    def at(self, time_s: Numbers) -> States:
        """Expected states at times (t,), s; those of the ends before and after."""
        times = numbers("time_s", time_s)
        if times.ndim != 1:
            raise InputError(f"time_s: shape {times.shape}, but it must be (t,)")
        tool, position, attitude, tensions, lengths, paid_out, speed = self._native.at(
            times.tolist()
        )
        return States(
            times, tool, position, attitude, tensions, lengths, paid_out, speed.reshape(-1)
        )

    @property
    def knots(self) -> Knots:
        """What goes to the board."""
        return Knots(*self._native.knots())

    def svg(self) -> str:
        """Path, lengths, tensions and tilt as a picture (SVG)."""
        return self._native.svg()

    def png(self) -> bytes:
        """The same picture as the bytes of a PNG file, 300 pixels per inch."""
        return self._native.png()

    def _repr_png_(self) -> bytes:
        return self.png()

    def __repr__(self) -> str:
        return f"<mcdpr.Plan {self.name}: {self.duration_s:.2f} s>"
