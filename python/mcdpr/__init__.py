"""Cable-driven parallel robots: kinematics, statics, planning, calibration, simulation, control.

SI units throughout, in names too: ``_m``, ``_n``, ``_s``, ``_rad``. The world's z axis points up;
attitudes are roll, pitch, yaw with R = Rz Ry Rx. Cables are counted from 1 in words and keys.
"""

from . import errors
from ._mcdpr import VERSION as __version__
from ._mcdpr import built_in
from .calibration import Calibration, calibrate
from .errors import (
    CalibrationError,
    Error,
    FaultError,
    InputError,
    KinematicsError,
    PlanError,
    RecordError,
    RobotError,
    RunError,
    ScenarioError,
    TaskError,
)
from .plan import Knots, Plan, States
from .record import Record
from .robot import VERDICTS, Equilibrium, Forward, Inverse, Robot, Workspace
from .session import Run, Session

__all__ = [
    "VERDICTS",
    "Calibration",
    "CalibrationError",
    "Equilibrium",
    "Error",
    "FaultError",
    "Forward",
    "InputError",
    "Inverse",
    "KinematicsError",
    "Knots",
    "Plan",
    "PlanError",
    "Record",
    "RecordError",
    "Robot",
    "RobotError",
    "Run",
    "RunError",
    "ScenarioError",
    "Session",
    "States",
    "TaskError",
    "Workspace",
    "__version__",
    "built_in",
    "calibrate",
    "errors",
]
