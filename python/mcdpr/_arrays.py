"""Arrays of any leading shape as rows for the native half, and back."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal, TypeVar, Union

import numpy as np
import numpy.typing as npt

from .errors import Error, InputError

Array = npt.NDArray[np.float64]
Numbers = npt.ArrayLike
OnError = Literal["raise", "nan"]
Tensions = Union[Mapping[int, float], Sequence[float], npt.NDArray[np.float64]]
T = TypeVar("T")


def numbers(name: str, value: Numbers, finite: bool = True) -> Array:
    """``value`` as an array of float64, refused with its name and place if it is not finite."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: not an array of numbers: {error}") from None
    if finite and not np.isfinite(array).all():
        where = tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0])
        place = f"[{', '.join(map(str, where))}]" if where else ""
        raise InputError(f"{name}{place} is {array[where]}: it must be finite", index=where)
    return array


def vectors(name: str, value: Numbers, width: int, what: str, finite: bool = True) -> Array:
    """``value`` as an array of shape (..., width)."""
    array = numbers(name, value, finite)
    if array.ndim == 0 or array.shape[-1] != width:
        raise InputError(
            f"{name}: shape {array.shape}, but the last axis must have {width} entries ({what})"
        )
    return array


def vector(name: str, value: Numbers, width: int, what: str, finite: bool = True) -> list[float]:
    """``value`` as a list of ``width`` numbers."""
    array = vectors(name, value, width, what, finite)
    if array.ndim != 1:
        raise InputError(f"{name}: shape {array.shape}, but it must be ({width},) ({what})")
    return [float(x) for x in array]


def rows(arrays: dict[str, Array | None]) -> tuple[tuple[int, ...], list[Array | None]]:
    """The common leading shape of arrays (..., k), and each of them as rows of it."""
    given = {name: array for name, array in arrays.items() if array is not None}
    try:
        lead = np.broadcast_shapes(*(array.shape[:-1] for array in given.values()))
    except ValueError:
        shapes = ", ".join(f"{name} {array.shape}" for name, array in given.items())
        raise InputError(f"leading shapes do not fit each other: {shapes}") from None
    flat: list[Array | None] = []
    for array in arrays.values():
        if array is None:
            flat.append(None)
            continue
        wide = np.broadcast_to(array, (*lead, array.shape[-1]))
        flat.append(np.ascontiguousarray(wide).reshape(-1, array.shape[-1]))
    return lead, flat


def called(lead: tuple[int, ...], call: Callable[[], T]) -> T:
    """Calls the native half; an exception gets its place in the array."""
    try:
        return call()
    except Error as error:
        if error.index is not None:
            error.index = tuple(int(k) for k in np.unravel_index(error.index[0], lead or (1,)))
            if not lead:
                error.index = ()
        raise


def wants_nan(on_error: OnError) -> bool:
    """Whether refused poses become NaN."""
    if on_error not in ("raise", "nan"):
        raise InputError(f'on_error: "{on_error}"; it is "raise" or "nan"')
    return on_error == "nan"


def tensions_by_cable(name: str, given: Tensions, cables: int) -> Array:
    """Held tensions (N) as an array (..., cables), NaN for length-held cables."""
    if isinstance(given, Mapping):
        array = np.full(cables, np.nan)
        for cable, tension in given.items():
            if not 1 <= cable <= cables:
                raise InputError(
                    f"{name}: there is no cable {cable}; this robot has cables 1 to {cables}"
                )
            array[cable - 1] = numbers(f"{name}[{cable}]", tension)
        return array
    return vectors(name, given, cables, "one per cable, NaN for a length-held one", finite=False)
