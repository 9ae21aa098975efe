"""Recorded runs as arrays and tables."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from . import _mcdpr

if TYPE_CHECKING:
    import pandas

Topic = Literal["ticks", "truth", "plan", "status"]


class Record:
    """A recorded run (``run.mcap`` or its folder). Each topic is a dict of arrays with one row each."""

    __slots__ = ("_native",)

    def __init__(self, native: _mcdpr.Record) -> None:
        self._native = native

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Record:
        """Reads a run's folder or file; one that is cut short is read as far as it goes.

        Raises:
            RecordError: there is no record, it is of another kind, or of another version.
        """
        return Record(_mcdpr.Record.load(os.fspath(path)))

    @property
    def path(self) -> str:
        """The file."""
        return self._native.path

    @property
    def duration_s(self) -> float:
        """Duration of the record, s."""
        return self._native.duration_s

    @property
    def damage(self) -> str | None:
        """What the file lacks, if it does not end as it should."""
        return self._native.damage

    @property
    def gaps(self) -> int:
        """Calls of the line that are missing inside the record."""
        return self._native.gaps

    @property
    def scenario(self) -> dict[str, Any]:
        """What was run: robot, task, options, machine, version."""
        return self._native.scenario()

    @property
    def ticks(self) -> dict[str, Any]:
        """What the board measured every millisecond; t rows, n cables.

        ``tick`` (t,), ``path_s`` (t,) NaN while nothing moves, ``lengths_m``, ``tensions_n``,
        ``currents_a``, ``planned_lengths_m``, ``planned_speeds_mps``, ``planned_tensions_n`` (t, n).
        """
        return self._native.ticks()

    @property
    def truth(self) -> dict[str, Any]:
        """Where a simulated robot truly was; empty on hardware.

        ``tick``, ``path_s`` (t,), ``tool_m``, ``position_m`` (t, 3), ``rotation_xyzw`` (t, 4),
        ``tensions_n`` (t, n).
        """
        return self._native.truth()

    @property
    def plan(self) -> dict[str, Any]:
        """What was planned, every 20 ms: keys as :attr:`truth`, without ``tick``."""
        return self._native.plan()

    @property
    def status(self) -> dict[str, Any]:
        """What the board said about itself, ten times a second: ``time_s``, ``tick``, ``path_s``,
        ``state``, ``fault`` (None without one)."""
        return self._native.status()

    @property
    def changes(self) -> list[tuple[float, str]]:
        """Changes of state and faults: time (s) and words."""
        return self._native.changes()

    @property
    def log(self) -> list[dict[str, Any]]:
        """The log: ``time_s``, ``level`` (2 info, 3 warning, 4 error), ``message``."""
        return self._native.log()

    def to_pandas(self, topic: Topic = "ticks") -> pandas.DataFrame:
        """A topic as a table; columns of cables are ``lengths_m.1`` and so on, vectors ``.x``.

        polars takes it by the dataframe interchange protocol: ``polars.from_dataframe(...)``.
        """
        return table(getattr(self, topic))

    def __repr__(self) -> str:
        return f"<mcdpr.Record {self.path}: {self.duration_s:.1f} s>"


def table(columns: dict[str, Any]) -> pandas.DataFrame:
    """A dict of arrays with one row each as a pandas table."""
    import pandas

    flat: dict[str, Any] = {}
    for name, values in columns.items():
        if not isinstance(values, np.ndarray) or values.ndim == 1:
            flat[name] = values
            continue
        vector = {"tool_m": "xyz", "position_m": "xyz", "rotation_xyzw": "xyzw"}.get(name)
        for k in range(values.shape[1]):
            flat[f"{name}.{vector[k] if vector else k + 1}"] = values[:, k]
    frame: pandas.DataFrame = pandas.DataFrame(flat)
    return frame
