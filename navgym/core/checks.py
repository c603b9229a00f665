"""Checks of a user's input: each error names the field, the value and the remedy."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def one_of(kind: str, name: object, choices: Iterable[str]) -> str:
    """Return `name` if it is among `choices`; else raise ValueError with the nearest match."""
    known = list(choices)
    if isinstance(name, str) and name in known:
        return name
    plain = {each.lower().replace("_", "-"): each for each in known}
    typed = str(name).lower().replace("_", "-")
    near = difflib.get_close_matches(typed, plain, n=1, cutoff=0.5)
    hint = f" Did you mean {plain[near[0]]!r}?" if near else ""
    raise ValueError(f"unknown {kind} {name!r}.{hint} Known: {', '.join(sorted(known))}.")


NO_NUMBERS = {
    "c": "complex numbers: take their real part, or real and imaginary part as two components",
    "M": "dates: turn them into seconds, for example (t - t[0]) / np.timedelta64(1, 's')",
    "m": "durations: turn them into seconds, for example dt / np.timedelta64(1, 's')",
    "U": "text: turn it into numbers first, for example with float",
    "S": "bytes: turn them into numbers first, for example with float",
    "V": "records: take the fields that are meant, one by one",
}  # by numpy's letter for the kind


def real_array(field: str, value: ArrayLike, finite: bool = True) -> Array:
    """`value` as a new float64 array; ValueError if it is not numeric or (by default) not finite.

    What numpy masks, or pandas calls NA, is NaN where that is allowed, and refused elsewhere.
    """
    value = _unmasked(field, value, finite)
    try:
        given = np.array(value)
    except ValueError:
        shown = short(value)
        raise ValueError(
            f"{field} must be an array of numbers, got {shown}: make its rows equally long."
        ) from None
    kind = given.dtype.kind
    if kind == "O" and any(isinstance(item, (str, bytes)) for item in given.flat):
        kind = "U"
    if kind in NO_NUMBERS:
        raise ValueError(
            f"{field} must be an array of numbers, got {short(value)}, which holds "
            f"{NO_NUMBERS[kind]}."
        )
    try:
        array = given.astype(np.float64, copy=False)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{field} must be an array of numbers, got {short(value)}: {error}."
        ) from None
    if finite and not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(
            f"{field} must be finite, got {array[where]} at index {where}: remove or repair it."
        )
    return array


def _unmasked(field: str, value: Any, finite: bool) -> Any:
    """`value` with NaN where a numpy mask, or pandas' NA, says that there is none."""
    if isinstance(value, (list, tuple)) and any(isinstance(v, np.ma.MaskedArray) for v in value):
        value = np.ma.array(value)
    if hasattr(value, "isna") and hasattr(value, "to_numpy"):  # a Series or a DataFrame
        try:
            value = value.to_numpy(dtype=np.float64, na_value=np.nan)
        except (TypeError, ValueError):  # of text, or the like, which is told below
            return value
    if not np.ma.is_masked(value):
        return value
    if finite:
        raise ValueError(
            f"{field} must hold a number everywhere, but {int(value.mask.sum())} of its entries "
            "are masked: fill them in, for example with .filled(...)."
        )
    return value.astype(np.float64).filled(np.nan) if value.dtype.kind in "biuf" else value


def short(value: object) -> str:
    """The beginning of `value` as it would be typed."""
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def shaped(field: str, array: NDArray[Any], shape: tuple[int, ...], because: str) -> None:
    """Raise ValueError unless `array` has `shape`."""
    if array.shape != shape:
        raise ValueError(f"{field} must have shape {shape} ({because}), got {array.shape}.")


def covariance(field: str, value: Array, definite: bool) -> None:
    """Raise ValueError unless the trailing matrices of `value` are symmetric and (semi-)definite."""
    scale = max(float(np.abs(value).max(initial=0.0)), 1e-300)
    if not np.allclose(value, np.swapaxes(value, -1, -2), rtol=0, atol=1e-9 * scale):
        raise ValueError(f"{field} must be symmetric, got\n{value}\nUse ({field} + {field}.T) / 2.")
    smallest = float(np.linalg.eigvalsh(value).min())
    if smallest <= 0.0 if definite else smallest < -1e-9 * scale:
        kind = "positive definite" if definite else "positive semi-definite"
        raise ValueError(
            f"{field} must be {kind}, but its smallest eigenvalue is {smallest:.3g}: "
            "a covariance needs positive variances and correlations inside (-1, 1)."
        )


def within(
    field: str, value: Any, low: float, high: float = math.inf, above: bool = False
) -> float:
    """`value` as a finite float in [low, high] (or above `low`); ValueError naming the field."""
    ok = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    number = float(value) if ok else math.nan
    if not (low <= number <= high) or (above and number == low) or math.isinf(number):
        if high < math.inf:
            wanted = f"a number in {low:g}..{high:g}"
        else:
            wanted = f"a finite number {'above' if above else 'of at least'} {low:g}"
        raise ValueError(f"{field} must be {wanted}, got {value!r}.")
    return number


def span(field: str, value: Any, low: float, above: bool = False, whole: bool = False) -> None:
    """Raise ValueError unless `value` is a pair (least, largest) of numbers from `low` on."""
    try:
        least, largest = value
    except (TypeError, ValueError):
        raise ValueError(f"{field} must be a pair (least, largest), got {value!r}.") from None
    for number in (least, largest):
        if whole:
            positive_int(field, number, int(low))
        within(field, number, low, above=above)
    if least > largest:
        raise ValueError(f"{field} must be (least, largest), got {value!r}: swap them.")


def positive_int(field: str, value: object, least: int = 1) -> int:
    """`value` as an int; ValueError unless it is a whole number of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"{field} must be a whole number of at least {least}, got {value!r}.")
    return int(value)
