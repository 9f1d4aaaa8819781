"""`hil replay --against OTHER LOG`: two logs column by column, tick by tick."""

import time
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import Any, Literal

from drivers.arrays import Rows
from drivers.errors import LogError
from drivers.tick_columns import Column
from hil.record.divergence import ColumnDivergence, Divergence, Place
from hil.record.log import Log
from hil.record.schema import IDENTITY
from hil.study.against.pairs import Alone, Unpaired, first_motion, paired
from hil.study.against.tolerances import read_tolerances

Alignment = Literal["tick", "motion"]
NOTHING_BUT_NUMBERS = ("tick",)
"""Columns that say where a row is, and are not compared where motions are aligned."""


def against(
    path: Path, golden: Path, words: Sequence[str] = (), *, align: Alignment = "tick"
) -> dict[str, Any]:
    """Compare a log with another one; key `success` tells whether it is the same within its tolerances.

    words : tolerances, as `tau=0.5`; align : `tick`, rows of one number are compared, or `motion`, they count
    from the first tick in which the platform moves. Their times `t_ns` count from the first of these rows.

    Raises LogError: a log that cannot be read, or two of which no row can be compared; ConfigurationError: a
    tolerance.
    """
    begun = time.perf_counter()
    one, other = Log.open(path), Log.open(golden)
    _refuse_unlike(one, other)
    common, only, unlike = _columns(one, other)
    tolerances = read_tolerances(words, common, {*only[0], *only[1], *unlike})
    starts, origins = ((0, 0), (one.origin_ns, other.origin_ns))
    if align == "motion":
        found = first_motion(one), first_motion(other)
        starts, origins = (found[0][0], found[1][0]), (found[0][1], found[1][1])
        common = [column for column in common if column.name not in NOTHING_BUT_NUMBERS]
    divergence, alone, ticks = Divergence(common, tolerances.absolute, tolerances.relative), Alone(), 0
    names = tuple(dict.fromkeys(("tick", "t_ns", *(column.name for column in common))))
    for a, b in paired(one, other, names, starts, alone):
        rows = _since(a, origins[0]), _since(b, origins[1])
        divergence.take(*rows, rows[0]["t_ns"] * 1e-9)
        ticks += len(a)
    if not ticks:
        raise LogError(f"{path}: has no tick in common with {golden}: nothing to compare")
    diverging = divergence.diverging
    return {
        "success": not diverging and max(alone.one.count, alone.other.count) <= tolerances.alone,
        "kind": "against",
        "log": str(path),
        "against": str(golden),
        "align": align,
        "relative_tolerance": _allowed(tolerances.relative),
        "tolerances": {name: _allowed(value) for name, value in tolerances.absolute.items()},
        "ticks_compared": ticks,
        "only_in_log": _alone(alone.one),
        "only_in_other": _alone(alone.other),
        "columns_compared": len(common),
        "columns_only_in_log": only[0],
        "columns_only_in_other": only[1],
        "columns_of_another_type": unlike,
        "diverging": [each.column.name for each in diverging],
        "columns": [_fields(each) for each in _ordered(divergence)],
        "wall_s": time.perf_counter() - begun,
    }


def _refuse_unlike(one: Log, other: Log) -> None:
    if one.topic != other.topic:
        raise LogError(
            f"{one.path}: holds {one.topic}, {other.path}: {other.topic}; allowed: two of one kind"
        )
    rates = [log.metadata.get(IDENTITY, {}).get("rate_Hz") for log in (one, other)]
    if rates[0] != rates[1]:
        here, there = (f"{rate:.40} Hz" if rate else "an unknown rate" for rate in rates)
        raise LogError(
            f"{one.path}: its loop ran at {here}, that of {other.path} at {there}; allowed: two of one rate"
        )


def _columns(one: Log, other: Log) -> tuple[list[Column], tuple[list[str], list[str]], list[str]]:
    """Return the columns that both logs have, which only one has, and which differ in type or shape."""
    there = {column.name: column for column in other.columns}
    here = {column.name: column for column in one.columns}
    both = [name for name in here if name in there]
    alike = [n for n in both if (here[n].kind, here[n].shape) == (there[n].kind, there[n].shape)]
    only = [name for name in here if name not in there], [name for name in there if name not in here]
    return [here[name] for name in alike], only, [name for name in both if name not in alike]


def _since(rows: Rows, origin_ns: int) -> Rows:
    """Return rows whose `t_ns` counts from an instant: where a run's clock begins says nothing of it."""
    found = rows.copy()
    found["t_ns"] -= origin_ns
    return found


def _ordered(divergence: Divergence) -> list[ColumnDivergence]:
    """Return the columns with a difference: those that diverge first, by tick."""
    found = divergence.diverging
    return [*found, *(each for each in divergence.different if each not in found)]


def _alone(ticks: Unpaired) -> dict[str, int | None]:
    return {"ticks": ticks.count, "first": ticks.first}


def _fields(found: ColumnDivergence) -> dict[str, Any]:
    column, tolerance = found.column, found.tolerance
    return {
        "column": column.name,
        "unit": column.unit,
        "tolerance": _allowed(tolerance.absolute),
        "relative_tolerance": tolerance.relative,
        "diverges": found.diverges,
        "ticks": found.ticks,
        "first": _place(found, found.first),
        "largest": None if column.names else found.largest,
        "at": _place(found, found.at),
    }


def _allowed(value: float) -> float | str:
    return value if isfinite(value) else "not judged"


def _place(found: ColumnDivergence, place: Place | None) -> dict[str, Any] | None:
    if place is None:
        return None
    here, there = place.values(found.column)
    where = {"tick": place.tick, "time_s": place.time_s, "element": place.label, "unit": place.unit}
    return where | {"log": here, "other": there}
