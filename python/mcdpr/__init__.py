"""Cable-driven parallel robots: kinematics, statics, planning, calibration, simulation, control.

SI units throughout, in names too: ``_m``, ``_n``, ``_s``, ``_rad``. The world's z axis points up;
attitudes are roll, pitch, yaw with R = Rz Ry Rx. Cables are counted from 1 in words and keys.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

# What is asked for is imported then: numpy alone takes a tenth of a second.
if TYPE_CHECKING:
    from . import errors as errors
    from ._mcdpr import VERSION as __version__
    from ._mcdpr import built_in as built_in
    from .calibration import Calibration as Calibration
    from .calibration import calibrate as calibrate
    from .errors import CalibrationError as CalibrationError
    from .errors import Error as Error
    from .errors import FaultError as FaultError
    from .errors import InputError as InputError
    from .errors import KinematicsError as KinematicsError
    from .errors import PlanError as PlanError
    from .errors import RecordError as RecordError
    from .errors import RobotError as RobotError
    from .errors import RunError as RunError
    from .errors import ScenarioError as ScenarioError
    from .errors import TaskError as TaskError
    from .plan import Knots as Knots
    from .plan import Plan as Plan
    from .plan import States as States
    from .record import Record as Record
    from .robot import VERDICTS as VERDICTS
    from .robot import Equilibrium as Equilibrium
    from .robot import Forward as Forward
    from .robot import Inverse as Inverse
    from .robot import Robot as Robot
    from .robot import Workspace as Workspace
    from .session import Run as Run
    from .session import Session as Session

_HOMES = {
    "_mcdpr": ("built_in",),
    "calibration": ("Calibration", "calibrate"),
    "errors": (
        "CalibrationError",
        "Error",
        "FaultError",
        "InputError",
        "KinematicsError",
        "PlanError",
        "RecordError",
        "RobotError",
        "RunError",
        "ScenarioError",
        "TaskError",
    ),
    "plan": ("Knots", "Plan", "States"),
    "record": ("Record",),
    "robot": ("VERDICTS", "Equilibrium", "Forward", "Inverse", "Robot", "Workspace"),
    "session": ("Run", "Session"),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}
_MODULES = ("calibration", "errors", "gym", "mujoco_model", "plan", "record", "robot", "session")

__all__ = sorted([*_HOME, "__version__", "errors"])


def __getattr__(name: str) -> object:
    found: object
    if name == "__version__":
        found = importlib.import_module("._mcdpr", __name__).VERSION
    elif name in _HOME:
        found = getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
    elif name in _MODULES:
        return importlib.import_module(f".{name}", __name__)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_MODULES})
