"""Calibration: measurements in, parameters with covariance out."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from . import _mcdpr
from ._arrays import Array
from .errors import CalibrationError

if TYPE_CHECKING:
    from .robot import Robot


class Calibration:
    """What a calibration found. Cable i of the robot is row i - 1."""

    __slots__ = ("_native",)

    def __init__(self, native: _mcdpr.Answer) -> None:
        self._native = native

    @property
    def document(self) -> dict[str, Any]:
        """Everything, as ``mcdpr calibrate all --json`` prints it (mm, kg, N, px)."""
        return self._native.document()

    @property
    def anchors_m(self) -> Array:
        """(n, 3): anchors, world, m."""
        return self._native.anchors_m

    @property
    def attachments_m(self) -> Array:
        """(n, 3): attachments, platform, m."""
        return self._native.attachments_m

    @property
    def initial_length_m(self) -> list[float]:
        """(n,): length of each cable where its encoder reads zero, m."""
        return self._native.initial_length_m

    @property
    def covariance(self) -> Array | None:
        """(u, u): covariance of all unknowns, SI, in the order of :attr:`unknowns`."""
        return self._native.covariance

    @property
    def unknowns(self) -> list[str]:
        """(u,): names with units, such as ``cable.1.anchor.x_m``."""
        return self._native.unknowns

    @property
    def predicted_error_m(self) -> float:
        """Predicted root mean square position error, m."""
        return self._native.predicted_error_m

    @property
    def warnings(self) -> list[str]:
        """What the user should know."""
        return self._native.warnings

    def file_text(self, robot: Robot) -> str:
        """The calibration file for the robot that the data were collected on.

        Raises:
            CalibrationError: the data are of another robot, or do not say of which.
        """
        return self._native.file(robot._native)

    def save(self, robot: Robot, path: str | os.PathLike[str]) -> None:
        """Writes the calibration file, whole or not at all."""
        target = Path(path)
        text = self.file_text(robot)
        part = target.with_name(target.name + ".part")
        part.write_text(text, encoding="utf-8")
        os.replace(part, target)


def calibrate(
    data: str | os.PathLike[str] | Mapping[str, Any],
    method: Literal["joint", "paper"] = "joint",
    *,
    without_statics: bool = False,
) -> Calibration:
    """Finds anchors, initial lengths, camera and tags from measurements.

    Args:
        data: a file of format ``mcdpr-calibration-data-1`` (``mcdpr calibrate collect``), or its
            contents.
        method: "joint" (all at once, with covariance) or "paper" (Mai et al., for comparison).
        without_statics: leave tensions and the equations of equilibrium out.

    Raises:
        CalibrationError: what is wrong with the data, and where.
    """
    if isinstance(data, Mapping):
        text = json.dumps(dict(data))
    else:
        try:
            text = Path(data).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise CalibrationError(f"calibration data {os.fspath(data)}: {error}") from None
    return Calibration(_mcdpr.Answer(text, method, without_statics))
