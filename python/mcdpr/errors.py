"""Exceptions. They have the words of the program ``mcdpr``, and its numbers as attributes.

Cables are counted from 1 in words and in the attribute ``cable``, as everywhere; Python indices of
arrays count from 0.
"""

from __future__ import annotations

from typing import Any


class Error(Exception):
    """Any refusal or failure.

    Attributes:
        message: what is wrong, in the program's words.
        help: what to do about it, or None.
        code: the program's code of it, such as ``mcdpr::plan::limit``, or None.
        causes: what lies behind it, outermost first.
        fields: every further number or word of it; also attributes of their own.
        index: where in an array of poses, or None.
    """

    message: str
    help: str | None
    code: str | None
    causes: list[str]
    fields: dict[str, Any]
    index: tuple[int, ...] | None

    def __init__(
        self,
        message: str,
        help: str | None = None,
        code: str | None = None,
        causes: list[str] | None = None,
        index: int | tuple[int, ...] | None = None,
        **fields: Any,
    ) -> None:
        super().__init__(message)
        self.message = message
        self.help = help
        self.code = code
        self.causes = causes or []
        self.fields = fields
        self.index = (index,) if isinstance(index, int) else index

    def __getattr__(self, name: str) -> Any:
        try:
            return self.__dict__["fields"][name]
        except KeyError:
            raise AttributeError(f"{type(self).__name__} has no {name}") from None

    def __str__(self) -> str:
        lines = [self.message]
        if self.index:
            lines[0] = f"[{', '.join(map(str, self.index))}]: {self.message}"
        lines += [f"  cause: {cause}" for cause in self.causes]
        if self.help:
            lines.append(f"  help: {self.help}")
        return "\n".join(lines)


class InputError(Error, ValueError):
    """An argument has the wrong shape, is not finite, or is not one of the allowed values."""


class RobotError(Error):
    """A robot file that is not there or wrong; ``problems`` lists every mistake with file and line."""


class KinematicsError(Error):
    """The mathematics refused; ``kind`` says how, such as ``NegativeTension`` with its ``cable``."""


class TaskError(Error):
    """There is no such task, or its file is wrong."""


class PlanError(Error):
    """A plan would break a limit: ``time_s``, ``tool_m``, ``what``, ``value``, ``limit``, ``unit``."""


class CalibrationError(Error):
    """Data or a calibration file are refused; ``path`` says where in the document."""


class RecordError(Error):
    """A recorded run cannot be read."""


class ScenarioError(Error):
    """A fault that does not exist or cannot be injected."""


class RunError(Error):
    """The robot, its board or the line to it."""


class FaultError(RunError):
    """The board stopped by itself: ``fault`` (such as ``S2``), ``cable``, ``value``, ``limit``.

    ``probable_cause`` and ``probable_cable``: what the samples around it show, where they show another.
    """
