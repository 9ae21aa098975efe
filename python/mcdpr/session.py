"""A connected robot: simulated in virtual time, or behind a port. Both answer to the same calls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any

from . import _mcdpr
from ._arrays import Numbers, vector
from .plan import Plan, Task, what_of


Engine = Callable[
    [list[float], list[float], float], tuple[Sequence[float], Sequence[float], Sequence[float]]
]
"""Called with unstretched lengths (n,) m from anchor to attachment at the end of a duration, their
rates (n,) m/s and that duration, s; gives the platform's position (3,) m, its quaternion w, x, y, z and
the tensions (n,) N."""


@dataclass(frozen=True)
class Run:
    """A motion that was made."""

    plan: Plan
    """What was planned."""
    measured: dict[str, Any]
    """What the board measured: ``tick``, ``path_s`` (t,), ``lengths_m``, ``tensions_n``,
    ``currents_a`` (t, n)."""
    truth: dict[str, Any]
    """What was true, every millisecond; empty on hardware. ``tick``, ``path_s``, ``time_s`` (t,),
    ``tool_m``, ``position_m`` (t, 3), ``rotation_xyzw`` (t, 4), ``lengths_m``, ``tensions_n``."""
    figures: dict[str, Any]
    """Errors of path, lengths and tension, m and N, as ``mcdpr run --json`` has them."""


class Session:
    """A robot under this program's control; use it in a ``with`` block.

    On a simulated robot time passes only in calls. On a real one it goes on, and the link is served
    by a thread of its own; Ctrl-C in a call stops the robot along its path and closes the brakes.
    """

    __slots__ = ("_native",)

    def __init__(self, native: _mcdpr.Session) -> None:
        self._native = native

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except Exception:
            # What went wrong in the block is what counts.
            if error is None:
                raise

    def arm(self) -> None:
        """Enables drives, checks brakes and directions, opens the brakes; it holds then.

        Raises:
            FaultError: the check that failed, with ``fault`` and ``cable``; the brakes are closed.
        """
        self._native.arm()

    def disarm(self) -> None:
        """Closes the brakes under torque, switches torque off, gives the board back."""
        self._native.disarm()

    def run(
        self, task: Task, *, speed_mps: float | None = None, height_m: float | None = None
    ) -> Run:
        """Plans a task from where the tool is, arms if need be, runs it, and holds at its end.

        Raises:
            PlanError: the first limit that it would break; nothing moved.
            FaultError: the board stopped by itself.
            RunError: the line to it; stopped by :meth:`stop`.
        """
        plan, followed = self._native.follow(what_of(task), speed_mps, height_m)
        return Run(Plan(plan), followed.measured(), followed.truth(), followed.figures())

    def move(self, place_m: Numbers, *, speed_mps: float | None = None) -> Run:
        """The tool goes straight to a place (3,), world, m; as :meth:`run`."""
        return self.run(vector("place_m", place_m, 3, "x, y, z"), speed_mps=speed_mps)

    def jog(self, velocity_mps: Numbers, seconds: float) -> str | None:
        """Moves the tool at a velocity (3,), world, m/s; the limit that ended it early, if one did."""
        return self._native.jog(vector("velocity_mps", velocity_mps, 3, "x, y, z"), seconds)

    def step(self, seconds: float) -> None:
        """Lets time pass.

        Raises:
            FaultError: an armed robot stopped by itself meanwhile.
        """
        self._native.wait(seconds)

    def gripper(self, closed: bool) -> None:
        """Opens or closes the gripper."""
        self._native.gripper(closed)

    def stop(self) -> None:
        """Stops what moves along its path and closes the brakes; from any thread."""
        self._native.stop()

    def clear(self) -> str | None:
        """Acknowledges a latched fault and gives it in words."""
        return self._native.clear()

    @property
    def status(self) -> dict[str, Any]:
        """What the board says: ``state``, ``tick``, ``lengths_m``, ``tensions_n``, ``fault``..."""
        return self._native.status()

    def inject(self, fault: str, *, strength: float = 1.0) -> None:
        """Breaks something of a simulated robot now: ``"S2:1"`` is fault S2 on cable 1, ``"P7"`` the
        emergency stop; docs/faults.md lists them. ``strength`` scales slips, offsets and rates.

        Raises:
            ScenarioError: there is no such fault, or it cannot be injected.
        """
        self._native.inject(fault, float(strength))

    def load(self, force_n: Numbers, moment_nm: Numbers = (0.0, 0.0, 0.0)) -> None:
        """Loads a simulated platform at its origin: force (3,) N and moment (3,) N m, world."""
        force = vector("force_n", force_n, 3, "x, y, z")
        self._native.load(force, vector("moment_nm", moment_nm, 3, "x, y, z"))

    def fly(self, engine: Engine) -> None:
        """Another engine has a simulated robot's platform and cables from now on.

        Winches, drives, brakes, sensors and the control core stay; every 0.2 ms the engine is
        called. :class:`mcdpr.mujoco_model.MujocoPlant` is one.
        """
        self._native.fly(engine)

    @property
    def now_s(self) -> float:
        """Virtual time since a simulated board got power, s."""
        return self._native.now_s()

    @property
    def truth(self) -> dict[str, Any]:
        """What is really the case in a simulated robot now: ``tool_m``, ``position_m``,
        ``velocity_mps`` (3,), ``rotation_xyzw`` (4,), ``lengths_m``, ``tensions_n`` (n,)..."""
        return self._native.truth()

    def take_truth(self) -> dict[str, Any]:
        """What was true in every tick since the last call or run; keys as :attr:`Run.truth`."""
        return self._native.take_truth()

    def close(self) -> None:
        """Ends the session; a robot that is armed is disarmed."""
        self._native.close()
