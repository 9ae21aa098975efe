"""The robot: its file, its calibration and its mathematics."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from . import _mcdpr
from ._arrays import (
    Array,
    Numbers,
    OnError,
    Tensions,
    called,
    numbers,
    rows,
    tensions_by_cable,
    vector,
    vectors,
    wants_nan,
)
from .errors import InputError

if TYPE_CHECKING:
    from .calibration import Calibration
    from .plan import Plan, Task
    from .session import Session

VERDICTS = (
    "feasible",
    "below_minimum",
    "above_maximum",
    "no_path",
    "tilted",
    "unstable",
    "unbalanced",
)
"""Names of the codes in :attr:`Workspace.verdicts`."""

Mismatch = Literal["exact", "realistic", "as_built", "as_found"]
Planner = Literal["equilibrium", "level"]
Tensioning = Literal["max_min", "setpoint"]
Shaping = Literal["none", "zv", "zvd"]


@dataclass(frozen=True)
class Inverse:
    """Cable geometry at poses; n cables, leading shape (...) of the poses."""

    lengths_m: Array
    """(..., n): from the anchor to the attachment, arc on the pulley included, m."""
    wrap_rad: Array
    """(..., n): angle wrapped on the pulley, rad."""
    directions: Array
    """(..., n, 3): unit vectors from the tangent point to the attachment, world."""
    tangent_points_m: Array
    """(..., n, 3): where the cable leaves its pulley, world, m."""


@dataclass(frozen=True)
class Forward:
    """Poses that fit cable lengths."""

    position_m: Array
    """(..., 3): platform's origin, world, m."""
    attitude_rad: Array
    """(..., 3): roll, pitch, yaw, rad; R = Rz Ry Rx."""
    residual_m: Array
    """(...): root mean square of the length residuals, m."""
    iterations: npt.NDArray[np.int64]
    """(...): steps taken."""


@dataclass(frozen=True)
class Equilibrium:
    """Platforms at rest; n cables."""

    position_m: Array
    """(..., 3): platform's origin, world, m."""
    attitude_rad: Array
    """(..., 3): roll, pitch, yaw, rad; R = Rz Ry Rx."""
    lengths_m: Array
    """(..., n): taut length from anchor to attachment, m."""
    tensions_n: Array
    """(..., n): tension of each cable, N."""
    paid_out_m: Array
    """(..., n): what the drums have paid out, by the robot file's EA and routing, m."""
    slack: npt.NDArray[np.bool_]
    """(..., n): cables without tension."""
    stable: npt.NDArray[np.bool_]
    """(...): whether the energy is at a minimum."""
    modes_hz: Array
    """(..., 6): natural frequencies, ascending, Hz; NaN beyond the freedoms that there are."""
    stiffness: Array
    """(..., 6, 6): by displacement and rotation, world, about the origin; N/m, N, N m."""


@dataclass(frozen=True)
class Workspace:
    """Verdicts on a grid of places."""

    x_m: Array
    """(nx,): places along x, world, m."""
    y_m: Array
    """(ny,)"""
    z_m: Array
    """(nz,)"""
    verdicts: npt.NDArray[np.uint8]
    """(nx, ny, nz): index into :data:`VERDICTS`."""
    cables: npt.NDArray[np.uint8]
    """(nx, ny, nz): the limiting cable, from 1; 0 where no single one limits."""

    @property
    def feasible(self) -> npt.NDArray[np.bool_]:
        """(nx, ny, nz): where the robot can be."""
        return np.asarray(self.verdicts == 0)

    @property
    def feasible_fraction(self) -> float:
        """Share of the places that are feasible."""
        return float(np.count_nonzero(self.feasible)) / max(1, self.verdicts.size)


class Robot:
    """A robot as its file describes it. Instances do not change; edits give new ones.

    >>> robot = Robot.load("paper-table5")
    >>> robot.ik([0.32, 0.0, -0.2]).lengths_m.shape
    (4,)
    """

    __slots__ = ("_native",)

    def __init__(self, native: _mcdpr.Robot) -> None:
        self._native = native

    @staticmethod
    def load(
        name_or_path: str | os.PathLike[str],
        calibration: str | os.PathLike[str] | Calibration | None = None,
    ) -> Robot:
        """The robot file at a path, or a built-in robot by name (:func:`mcdpr.built_in`).

        A calibration is applied only where one is given; the program looks beside the robot file.

        Raises:
            RobotError: with every mistake of the file.
            CalibrationError: the calibration is of another robot, or unreadable.
        """
        robot = Robot(_mcdpr.Robot.load(os.fspath(name_or_path)))
        return robot if calibration is None else robot.calibrated(calibration)

    @staticmethod
    def parse(text: str, origin: str | os.PathLike[str] = "robot.toml") -> Robot:
        """From the text of a robot file; ``origin`` names it in messages.

        Raises:
            RobotError: with every mistake of the text.
        """
        return Robot(_mcdpr.Robot.parse(text, os.fspath(origin)))

    @property
    def name(self) -> str:
        """Name of the robot."""
        return self._native.name

    @property
    def cable_count(self) -> int:
        """Number of cables, n."""
        return self._native.cable_count

    @property
    def is_calibrated(self) -> bool:
        """Whether a calibration is applied."""
        return self._native.is_calibrated

    def at_rest(self) -> dict[str, float] | None:
        """Expected error of the platform at rest over the robot's space, its tilt included, as ``mcdpr calibrate all``
        states it.

        ``position_m`` and ``attitude_rad`` are root mean squares over ``places``, ``worst_position_m`` and
        ``worst_attitude_rad`` those of one place. By the applied calibration, else by the tolerances of a frame as
        built. ``None`` where the robot cannot rest.
        """
        return self._native.at_rest()

    @property
    def content_hash(self) -> int:
        """CRC-32 of the description: equal for files that describe the same robot."""
        return self._native.content_hash

    @property
    def text(self) -> str:
        """Text of the robot file."""
        files = self._native.files
        return files[0][1] if files else ""

    @property
    def values(self) -> dict[str, Any]:
        """Every value, defaults filled in, SI units: what ``mcdpr config show --json`` prints."""
        return self._native.values()

    def __repr__(self) -> str:
        calibrated = ", calibrated" if self.is_calibrated else ""
        return f"<mcdpr.Robot {self.name}: {self.cable_count} cables{calibrated}>"

    def edited(self, changes: Mapping[str, Any] | None = None, **more: Any) -> Robot:
        """The robot with other values of its file, in the file's units.

        Keys are dotted; a number counts cables or winches from 1: ``{"platform.mass_kg": 1.6,
        "cable.2.anchor_mm": [40.0, 380.0, 24.0]}``. A calibration that was applied is left out.

        Raises:
            InputError: there is no such place in the file.
            RobotError: the file would be wrong, with the key.
        """
        values = {**(changes or {}), **more}
        for key, value in values.items():
            if isinstance(value, np.ndarray):
                values[key] = value.tolist()
        try:
            text = json.dumps(values, allow_nan=False, default=float)
        except (TypeError, ValueError) as error:
            raise InputError(f"changes: {error}") from None
        return Robot(self._native.edited(text))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the robot file, and beside it the winch module files that it names.

        A module file that is there already is not touched.
        """
        target = Path(path)
        for index, (name, text) in enumerate(self._native.files):
            file = target if index == 0 else target.parent / name
            if index and file.exists():
                continue
            file.parent.mkdir(parents=True, exist_ok=True)
            part = file.with_name(file.name + ".part")
            part.write_text(text, encoding="utf-8")
            os.replace(part, file)

    def calibrated(self, calibration: str | os.PathLike[str] | Calibration) -> Robot:
        """The robot with a calibration applied: a file of ``mcdpr calibrate``, or an answer.

        Raises:
            CalibrationError: it is of another robot, or unreadable.
        """
        if isinstance(calibration, (str, os.PathLike)):
            return Robot(self._native.calibrated(os.fspath(calibration)))
        return Robot(self._native.calibrated_by(calibration.file_text(self), "the calibration"))

    def to_mjcf(self, *, every_winch: bool = False) -> str:
        """The robot at home as a MuJoCo model: what ``mcdpr model export --to mjcf`` writes.

        With ``every_winch`` the tension-held cables are elastic and hang on winches, too.

        Raises:
            KinematicsError: it cannot hang at home, or all its cables lie in one plane.
        """
        return self._native.model_file("mjcf", every_winch)

    def to_urdf(self) -> str:
        """The robot at home as URDF, for display: a URDF is a tree and holds no cables."""
        return self._native.model_file("urdf", False)

    # -- geometry ---------------------------------------------------------------------------------

    def _poses(
        self, position_m: Numbers, attitude_rad: Numbers | None, **more: Array | None
    ) -> tuple[tuple[int, ...], list[Array | None]]:
        position = vectors("position_m", position_m, 3, "x, y, z")
        attitude = None
        if attitude_rad is not None:
            attitude = vectors("attitude_rad", attitude_rad, 3, "roll, pitch, yaw")
        return rows({"position_m": position, "attitude_rad": attitude, **more})

    def lengths(
        self,
        position_m: Numbers,
        attitude_rad: Numbers | None = None,
        *,
        tool: bool = False,
        on_error: OnError = "raise",
    ) -> Array:
        """Cable lengths (..., n), m: :meth:`ik` without the rest, the fastest call.

        Args:
            position_m: (..., 3) platform's origin, or the tool with ``tool``; world, m.
            attitude_rad: (..., 3) roll, pitch, yaw, rad (R = Rz Ry Rx); level if None.
            on_error: "raise" at the first pose that is refused, or "nan" in its place.
        """
        lead, (position, attitude) = self._poses(position_m, attitude_rad)
        nan = wants_nan(on_error)
        assert position is not None
        found = called(lead, lambda: self._native.lengths(position, attitude, tool, nan))
        return found.reshape(*lead, self.cable_count)

    def ik(
        self,
        position_m: Numbers,
        attitude_rad: Numbers | None = None,
        *,
        tool: bool = False,
        on_error: OnError = "raise",
    ) -> Inverse:
        """Cable lengths, wrap angles and directions at poses; arguments as :meth:`lengths`.

        Raises:
            KinematicsError: an attachment inside its pulley or on its swivel axis, with ``cable``
                and, in arrays, ``index``.
            InputError: shape or a number that is not finite, with its place.
        """
        lead, (position, attitude) = self._poses(position_m, attitude_rad)
        nan = wants_nan(on_error)
        n = self.cable_count
        assert position is not None
        lengths, wraps, directions, tangents = called(
            lead, lambda: self._native.ik(position, attitude, tool, nan)
        )
        return Inverse(
            lengths.reshape(*lead, n),
            wraps.reshape(*lead, n),
            directions.reshape(*lead, n, 3),
            tangents.reshape(*lead, n, 3),
        )

    def jacobian(
        self,
        position_m: Numbers,
        attitude_rad: Numbers | None = None,
        *,
        tool: bool = False,
        by: Literal["twist", "euler"] = "twist",
        on_error: OnError = "raise",
    ) -> Array:
        """Derivatives of the lengths (..., n, 6) by position (world) and turning.

        ``by`` is "twist" (angular velocity, world, m/rad) or "euler" (rates of roll, pitch, yaw).
        """
        if by not in ("twist", "euler"):
            raise InputError(f'by: "{by}"; it is "twist" or "euler"')
        lead, (position, attitude) = self._poses(position_m, attitude_rad)
        nan = wants_nan(on_error)
        assert position is not None
        found = called(
            lead, lambda: self._native.jacobian(position, attitude, tool, by == "euler", nan)
        )
        return found.reshape(*lead, self.cable_count, 6)

    def structure_matrix(
        self,
        position_m: Numbers,
        attitude_rad: Numbers | None = None,
        *,
        on_error: OnError = "raise",
    ) -> Array:
        """(..., 6, n): wrench (N, N m, world, about the origin) of a unit tension of each cable."""
        return -np.swapaxes(self.jacobian(position_m, attitude_rad, on_error=on_error), -1, -2)

    def fk(
        self,
        lengths_m: Numbers,
        attitude_rad: Numbers | None = None,
        *,
        free: Literal["yaw", "all"] | None = None,
        max_residual_m: float = 1e-3,
        on_error: OnError = "raise",
    ) -> Forward:
        """Poses from lengths alone, without gravity.

        Args:
            lengths_m: (..., n), from anchor to attachment, m.
            attitude_rad: (..., 3) the attitude; with ``free="yaw"`` its roll and pitch, with "all"
                where to start. Level if None; six cables and more then find the attitude.
            free: what the lengths shall fix besides the position.
            max_residual_m: a pose that misses the lengths by more (root mean square) is refused.
        """
        lengths = vectors("lengths_m", lengths_m, self.cable_count, "one per cable")
        attitude = None
        if attitude_rad is not None:
            attitude = vectors("attitude_rad", attitude_rad, 3, "roll, pitch, yaw")
        lead, (flat, turned) = rows({"lengths_m": lengths, "attitude_rad": attitude})
        nan = wants_nan(on_error)
        assert flat is not None
        position, angles, residual, iterations = called(
            lead, lambda: self._native.forward(flat, turned, free, max_residual_m, nan)
        )
        return Forward(
            position.reshape(*lead, 3),
            angles.reshape(*lead, 3),
            residual.reshape(lead),
            np.nan_to_num(iterations).astype(np.int64).reshape(lead),
        )

    # -- statics ----------------------------------------------------------------------------------

    def _held(self, tensions_n: Tensions | Literal["setpoint"] | None) -> Array:
        """Tensions by cable; the set-point of the robot file without any."""
        if tensions_n is not None and not isinstance(tensions_n, str):
            return tensions_by_cable("tensions_n", tensions_n, self.cable_count)
        if isinstance(tensions_n, str) and tensions_n != "setpoint":
            raise InputError(f'tensions_n: "{tensions_n}"; the only word is "setpoint"')
        held = np.full(self.cable_count, np.nan)
        held[self._native.tension_held] = self.values["tension"]["setpoint_n"]
        return held

    def _equilibrium(self, lead: tuple[int, ...], found: list[Array]) -> Equilibrium:
        n = self.cable_count
        position, attitude, lengths, tensions, paid_out, slack, stable, modes, stiffness = found
        return Equilibrium(
            position.reshape(*lead, 3),
            attitude.reshape(*lead, 3),
            lengths.reshape(*lead, n),
            tensions.reshape(*lead, n),
            paid_out.reshape(*lead, n),
            slack.reshape(*lead, n) == 1.0,
            stable.reshape(lead) == 1.0,
            modes.reshape(*lead, 6),
            stiffness.reshape(*lead, 6, 6),
        )

    def statics(
        self,
        position_m: Numbers,
        tensions_n: Tensions | Literal["setpoint"] | None = None,
        attitude_rad: Numbers | None = None,
        *,
        tool: bool = False,
        on_error: OnError = "raise",
    ) -> Equilibrium:
        """How the platform hangs with its origin (or tool) at places.

        Args:
            position_m: (..., 3), world, m.
            tensions_n: of the tension-held cables: ``{4: 10.0}`` (cables from 1), or (..., n) with
                NaN for length-held ones, N. None: those of the robot file at the tension that a plan
                chooses at each place; "setpoint": at its constant set-point.
            attitude_rad: (..., 3), only where six or more cables are length-held; level if None.

        Raises:
            KinematicsError: a cable would have to push, the place is singular, and so on.
        """
        held = self._held(tensions_n)
        places = numbers("position_m", position_m)
        if tensions_n is None and places.ndim > 0 and places.shape[-1] == 3:
            lead = places.shape[:-1]
            held = self._native.planned(places.reshape(-1, 3), tool).reshape(*lead, self.cable_count)
        lead, (position, attitude, flat) = self._poses(position_m, attitude_rad, tensions_n=held)
        nan = wants_nan(on_error)
        assert position is not None and flat is not None
        found = called(lead, lambda: self._native.hang(position, flat, attitude, tool, nan))
        return self._equilibrium(lead, found)

    def stiffness(
        self,
        position_m: Numbers,
        tensions_n: Tensions | Literal["setpoint"] | None = None,
        *,
        tool: bool = False,
        on_error: OnError = "raise",
    ) -> Array:
        """(..., 6, 6) stiffness of the hanging platform, as :attr:`Equilibrium.stiffness`."""
        return self.statics(position_m, tensions_n, tool=tool, on_error=on_error).stiffness

    def modes(
        self,
        position_m: Numbers,
        tensions_n: Tensions | Literal["setpoint"] | None = None,
        *,
        tool: bool = False,
        on_error: OnError = "raise",
    ) -> Array:
        """(..., 6) natural frequencies, Hz, as :attr:`Equilibrium.modes_hz`."""
        return self.statics(position_m, tensions_n, tool=tool, on_error=on_error).modes_hz

    def fk_static(
        self,
        lengths_m: Numbers,
        tensions_n: Tensions | None = None,
        *,
        on_error: OnError = "raise",
    ) -> Equilibrium:
        """The pose at rest under gravity for held lengths and tensions; cables may go slack.

        Args:
            lengths_m: (..., n) with NaN for tension-held cables, or one per length-held cable, m.
            tensions_n: as in :meth:`statics`.
        """
        held = self._held(tensions_n)
        n = self.cable_count
        lengths = numbers("lengths_m", lengths_m, finite=False)
        pattern = np.isnan(held)
        by_length = int(np.count_nonzero(pattern.reshape(-1, n)[0]))
        if not (pattern == pattern.reshape(-1, n)[0]).all():
            raise InputError("tensions_n: the same cables must be tension-held in every row")
        if lengths.ndim and lengths.shape[-1] == by_length != n:
            wide = np.full((*lengths.shape[:-1], n), np.nan)
            wide[..., pattern.reshape(-1, n)[0]] = numbers("lengths_m", lengths)
            lengths = wide
        elif lengths.ndim == 0 or lengths.shape[-1] != n:
            raise InputError(
                f"lengths_m: shape {lengths.shape}, but the last axis must have {by_length} entries "
                f"(one per length-held cable) or {n}"
            )
        if np.isinf(lengths).any():
            numbers("lengths_m", np.nan_to_num(lengths, nan=0.0, posinf=np.inf, neginf=-np.inf))
        lead, (flat, tensions) = rows({"lengths_m": lengths, "tensions_n": held})
        nan = wants_nan(on_error)
        assert flat is not None and tensions is not None
        found = called(lead, lambda: self._native.rest(flat, tensions, nan))
        return self._equilibrium(lead, found)

    def distribute(
        self,
        position_m: Numbers,
        attitude_rad: Numbers | None = None,
        *,
        wrench: Numbers = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        min_n: Numbers | None = None,
        max_n: Numbers | None = None,
        goal: Literal["middle", "minimum_norm"] | Numbers = "middle",
        balance: Literal["wrench", "forces"] = "wrench",
        on_error: OnError = "raise",
    ) -> Array:
        """Tensions (..., n), N, within limits that balance gravity and an external wrench.

        Args:
            wrench: (..., 6) force (N) and moment (N m) on the platform, world, about its origin.
            min_n, max_n: limits, a number or one per cable; those of the robot file if None.
            goal: nearest to the middle of the limits, least squares, or nearest to given (n,)
                tensions.
            balance: "forces" leaves the moments out (the paper's level platform).
        """
        n = self.cable_count
        limits = self.values["limits"]

        def limit(name: str, given: Numbers | None, own: float) -> list[float]:
            array = numbers(name, own if given is None else given)
            return vector(name, np.broadcast_to(array, (n,)) if array.ndim == 0 else array, n, "")

        low = limit("min_n", min_n, limits["tension_min_n"])
        high = limit("max_n", max_n, limits["tension_max_n"])
        near = None
        if not isinstance(goal, str):
            near = vector("goal", goal, n, "a tension per cable")
        elif goal not in ("middle", "minimum_norm"):
            raise InputError(f'goal: "{goal}"; it is "middle", "minimum_norm" or tensions')
        if balance not in ("wrench", "forces"):
            raise InputError(f'balance: "{balance}"; it is "wrench" or "forces"')
        load = vectors("wrench", wrench, 6, "force and moment")
        lead, (position, attitude, flat) = self._poses(position_m, attitude_rad, wrench=load)
        nan = wants_nan(on_error)
        assert position is not None and flat is not None
        found = called(
            lead,
            lambda: self._native.distribute(
                position,
                attitude,
                flat,
                low,
                high,
                balance == "forces",
                isinstance(goal, str) and goal == "minimum_norm",
                near,
                nan,
            ),
        )
        return found.reshape(*lead, n)

    def workspace(
        self,
        step_m: float | None = 0.02,
        *,
        min_m: Numbers | None = None,
        max_m: Numbers | None = None,
        counts: tuple[int, int, int] | None = None,
        test: Literal["equilibrium", "wrench", "forces"] | None = None,
        tensions_n: Tensions | Literal["setpoint"] | None = None,
        attitude_rad: Numbers = (0.0, 0.0, 0.0),
        tool: bool = True,
    ) -> Workspace:
        """Where the robot can be, on a grid over its box (or ``min_m`` to ``max_m``), on all cores.

        Args:
            step_m: distance of the places; or ``counts`` of them along x, y, z.
            test: "equilibrium" (hangs there stably within its limits; three length-held cables),
                "wrench" or "forces" (tensions within the limits balance gravity at
                ``attitude_rad``). None: equilibrium for three length-held cables, else wrench.
            tensions_n: as in :meth:`statics`.
            tool: places are those of the tool, not of the platform's origin.
        """
        own = self._native.search_box_m
        low = np.array(vector("min_m", own[0] if min_m is None else min_m, 3, "x, y, z"))
        high = np.array(vector("max_m", own[1] if max_m is None else max_m, 3, "x, y, z"))
        if counts is None:
            if step_m is None or not step_m > 0.0:
                raise InputError(f"step_m: {step_m}; it must be positive")
            fitting = np.floor((high - low) / step_m * (1.0 + 1e-12)) + 1.0
            if not (fitting >= 1.0).all() or fitting.prod() > 2e7:
                raise InputError(f"step_m: {step_m} gives {fitting.prod():.3g} places")
            counts = (int(fitting[0]), int(fitting[1]), int(fitting[2]))
            high = low + (fitting - 1.0) * step_m
        elif min(counts) < 1 or np.prod(counts, dtype=float) > 2e7:
            raise InputError(f"counts: {counts}; each is 1 or more, 2e7 places at most")
        held = self._held(tensions_n)
        if held.ndim != 1:
            raise InputError(f"tensions_n: shape {held.shape}, but it must be ({self.cable_count},)")
        if test is None:
            test = "equilibrium" if np.count_nonzero(np.isnan(held)) == 3 else "wrench"
        elif test not in ("equilibrium", "wrench", "forces"):
            raise InputError(f'test: "{test}"; it is "equilibrium", "wrench" or "forces"')
        limits = self.values["limits"]
        lowest = np.full(self.cable_count, limits["tension_min_n"])
        highest = np.full(self.cable_count, limits["tension_max_n"])
        if test != "equilibrium" and tensions_n is not None:
            # Given tensions are no unknowns: they are pinned by the limits.
            lowest = np.where(np.isnan(held), lowest, held)
            highest = np.where(np.isnan(held), highest, held)
        codes, cables = self._native.workspace(
            low.tolist(),
            high.tolist(),
            counts,
            test,
            tool,
            vector("attitude_rad", attitude_rad, 3, "roll, pitch, yaw"),
            None if tensions_n is None else held.tolist(),
            lowest.tolist(),
            highest.tolist(),
            limits["tilt_max_rad"],
        )
        shape = counts[::-1]

        def axis(k: int) -> Array:
            step = (high[k] - low[k]) / (counts[k] - 1) if counts[k] > 1 else 0.0
            return np.asarray(low[k] + step * np.arange(counts[k]))

        return Workspace(
            axis(0),
            axis(1),
            axis(2),
            codes.reshape(shape).transpose(2, 1, 0),
            cables.reshape(shape).transpose(2, 1, 0),
        )

    # -- motion -----------------------------------------------------------------------------------

    def plan(
        self,
        task: Task,
        *,
        start_m: Numbers | None = None,
        speed_mps: float | None = None,
        height_m: float | None = None,
        planner: Planner = "equilibrium",
        tensioning: Tensioning = "max_min",
        shaping: Shaping = "none",
    ) -> Plan:
        """A task planned and judged from ``start_m`` (the tool, world, m; home if None).

        Args:
            task: a built-in task, a task file, the text of one (``"text:..."``), or a place of
                the tool (3,) to go to straight.
            speed_mps: for the way to the task's start.
            height_m: of a level platform's origin in a built-in task.

        Raises:
            PlanError: the first limit that it would break; nothing moves.
            TaskError: there is no such task.
        """
        from .plan import Plan, what_of

        start = None if start_m is None else vector("start_m", start_m, 3, "x, y, z")
        return Plan(
            _mcdpr.Plan(
                self._native,
                what_of(task),
                start,
                speed_mps,
                height_m,
                planner,
                tensioning,
                shaping,
            )
        )

    def sim(
        self,
        seed: int = 1,
        mismatch: Mismatch | Mapping[str, Any] = "realistic",
        *,
        planner: Planner = "equilibrium",
        tensioning: Tensioning = "max_min",
        shaping: Shaping = "none",
        keep_truth: bool = True,
    ) -> Session:
        """A simulated robot of this description that hangs at home, brakes closed, in virtual time.

        Args:
            seed: of everything random; the same seed gives the same run bit by bit.
            mismatch: how far the machine is from its description.
            keep_truth: keep the true state of every millisecond for :meth:`Session.take_truth` and
                the runs' truth (350 bytes each).
        """
        from .session import Session

        words = mismatch if isinstance(mismatch, str) else json.dumps(dict(mismatch))
        return Session(
            _mcdpr.Session.simulate(
                self._native, seed, words, planner, tensioning, shaping, keep_truth
            )
        )

    def connect(
        self,
        port: str,
        home_m: Numbers | None = None,
        *,
        time_scale: float = 1.0,
        planner: Planner = "equilibrium",
        tensioning: Tensioning = "max_min",
        shaping: Shaping = "none",
    ) -> Session:
        """The robot behind a serial port. Nothing moves until it is armed.

        Args:
            port: a board's serial device, or the one that ``mcdpr sim --pty`` prints.
            home_m: (3,) where the tool hangs now (world, m), if the board has lost its lengths.
            time_scale: that of ``mcdpr sim --pty --time-scale``; a board has 1.
        """
        from .session import Session

        home = None if home_m is None else vector("home_m", home_m, 3, "x, y, z")
        return Session(
            _mcdpr.Session.connect(
                self._native, port, home, time_scale, planner, tensioning, shaping
            )
        )
