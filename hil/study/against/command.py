"""`hil replay --against OTHER LOG`: two logs column by column, tick by tick."""

import time
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import Any, Literal

import numpy as np

from drivers.arrays import Rows
from drivers.errors import LogError
from drivers.tick_columns import Column
from hil.record.divergence import ColumnDivergence, Divergence
from hil.record.log import Log
from hil.record.schema import IDENTITY
from hil.study import divergences
from hil.study.against.pairs import first_motion, paired
from hil.study.against.tolerances import read_tolerances

Alignment = Literal["tick", "motion"]
SIDES = divergences.Sides("element", "log", "other")


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
        (tick, t_ns), (there, there_ns) = first_motion(one), first_motion(other)
        starts, origins = (tick, there), (t_ns, there_ns)
        common = [column for column in common if column.name != "tick"]
    divergence, ticks = Divergence(common, tolerances.absolute, tolerances.relative), 0
    alone = [[np.zeros(0, np.int64)], [np.zeros(0, np.int64)]]
    names = tuple(dict.fromkeys(("tick", "t_ns", *(column.name for column in common))))
    for a, b, *lone in paired(one, other, names, starts):
        if len(a):
            rows = _since(a, origins[0]), _since(b, origins[1])
            divergence.take(*rows, rows[0]["t_ns"] * 1e-9)
            ticks += len(a)
        for found, more in zip(alone, lone, strict=True):
            found.append(more)
    unpaired = [np.concatenate(each) for each in alone]
    if not ticks:
        raise LogError(f"{path}: has no tick in common with {golden}: nothing to compare")
    diverging = divergence.diverging
    # those that diverge first, by tick; then those with a difference that is allowed
    different = [*diverging, *(each for each in divergence.different if not each.diverges)]
    return {
        "success": not diverging and max(map(len, unpaired)) <= tolerances.alone,
        "kind": "against",
        "log": str(path),
        "against": str(golden),
        "align": align,
        "relative_tolerance": _allowed(tolerances.relative),
        "tolerances": {name: _allowed(value) for name, value in tolerances.absolute.items()},
        "ticks_compared": ticks,
        **{
            f"only_in_{side}": {"ticks": len(each), "first": int(each[0]) if len(each) else None}
            for side, each in zip(("log", "other"), unpaired, strict=True)
        },
        "columns_compared": len(common),
        "columns_only_in_log": only[0],
        "columns_only_in_other": only[1],
        "columns_of_another_type": unlike,
        "diverging": [each.column.name for each in diverging],
        "columns": [_fields(each) for each in different],
        "wall_s": time.perf_counter() - begun,
    }


def _refuse_unlike(one: Log, other: Log) -> None:
    a, b = (str(log.metadata.get(IDENTITY, {}).get("rate_Hz", "?")) for log in (one, other))
    for what, here, there in (("holds", one.topic, other.topic), ("ran at Hz", a, b)):
        if here != there:
            raise LogError(
                f"{one.path}: {what} {here:.40}, {other.path}: {there:.40}; allowed: two of one kind and rate"
            )


def _columns(one: Log, other: Log) -> tuple[list[Column], tuple[list[str], list[str]], list[str]]:
    """Return the columns that both logs have, which only one has, and which differ in type or shape."""
    here, there = ({column.name: column for column in log.columns} for log in (one, other))
    both = [name for name in here if name in there]
    alike = [n for n in both if (here[n].kind, here[n].shape) == (there[n].kind, there[n].shape)]
    only = [name for name in here if name not in there], [name for name in there if name not in here]
    return [here[name] for name in alike], only, [name for name in both if name not in alike]


def _since(rows: Rows, origin_ns: int) -> Rows:
    """Return rows whose `t_ns` counts from an instant: where a run's clock begins says nothing of it."""
    found = rows.copy()
    found["t_ns"] -= origin_ns
    return found


def _fields(found: ColumnDivergence) -> dict[str, Any]:
    return divergences.fields(found, SIDES) | {
        "tolerance": _allowed(found.tolerance.absolute),
        "relative_tolerance": found.tolerance.relative,
        "diverges": found.diverges,
    }


def _allowed(value: float) -> float | str:
    return value if isfinite(value) else "not judged"
