"""`hil replay --against OTHER_LOG`: compares two logs column by column, tick by tick."""

import time
from collections.abc import Collection, Iterator, Sequence
from difflib import get_close_matches
from math import inf, isfinite, isnan
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from drivers.arrays import Ints, Rows
from drivers.errors import ConfigurationError, LogError
from drivers.signals import Mode
from drivers.tick_columns import Column
from hil.loop.modes import MOVING
from hil.record.divergence import Divergence
from hil.record.log import Log
from hil.record.schema import IDENTITY
from hil.study import divergences, table

Alignment = Literal["tick", "motion"]
SIDES = ("log", "other")
MOVED = MOVING - {Mode.RELEASING}
"""Modes of planned motion. A run that ends before its approach is never in one of them."""


class Origin(NamedTuple):
    """Tick number and time, ns, from which the ticks of a log are counted."""

    tick: int
    t_ns: int


def against(
    path: Path, golden: Path, words: Sequence[str] = (), *, align: Alignment = "tick"
) -> dict[str, Any]:
    """Compare two logs; key `success` of the result is True if they agree within the tolerances.

    words : tolerances, as `tau=0.5`. align : `tick` compares rows of the same tick number; `motion` counts
    ticks from the first motion of the platform. `t_ns` counts from the log's first row or from that tick.

    Raises LogError: a log cannot be read, or the logs have no row in common; ConfigurationError: an invalid
    tolerance.
    """
    begun = time.perf_counter()
    logs = one, other = Log.open(path), Log.open(golden)
    _refuse_unlike(one, other)
    common, only, unlike = _columns(one, other)
    relative, absolute = read_tolerances(words, common, {*only[0], *only[1], *unlike})
    origins = [Origin(0, log.origin_ns) for log in logs]
    if align == "motion":
        origins = [first_motion(log) for log in logs]
        common = [column for column in common if column.name != "tick"]
    numbers = [_numbers(log, origin) for log, origin in zip(logs, origins, strict=True)]
    both = np.intersect1d(numbers[0], numbers[1])
    if not len(both):
        raise LogError(
            f"{path}: has no tick in common with {golden}; a comparison needs logs with common ticks"
        )
    alone = [np.setdiff1d(n, both) + origin.tick for n, origin in zip(numbers, origins, strict=True)]
    divergence = Divergence(common, absolute, relative)
    names = tuple(dict.fromkeys(("tick", "t_ns", *(column.name for column in common))))
    for a, b in paired(*(_common(log, names, o, both) for log, o in zip(logs, origins, strict=True))):
        divergence.take(a, b, a["t_ns"] * 1e-9)
    diverging = divergence.diverging
    # diverging columns by tick, then columns with differences within tolerance
    different = [*diverging, *(each for each in divergence.different if not each.diverges)]
    most_alone = absolute.get("tick", inf if relative == inf else 0.0)
    return {
        "success": not diverging and max(map(len, alone)) <= most_alone,
        "kind": "against",
        "log": str(path),
        "against": str(golden),
        "align": align,
        "relative_tolerance": _allowed(relative),
        "tolerances": {name: _allowed(value) for name, value in absolute.items()},
        "ticks_compared": len(both),
        **{
            f"only_in_{side}": {"ticks": len(each), "first": int(each[0]) if len(each) else None}
            for side, each in zip(SIDES, alone, strict=True)
        },
        "columns_compared": len(common),
        "columns_only_in_log": only[0],
        "columns_only_in_other": only[1],
        "columns_of_another_type": unlike,
        "diverging": [each.column.name for each in diverging],
        "columns": [
            divergences.fields(each, SIDES)
            | {
                "tolerance": _allowed(each.absolute),
                "relative_tolerance": each.relative,
                "diverges": each.diverges,
            }
            for each in different
        ],
        "wall_s": time.perf_counter() - begun,
    }


def _refuse_unlike(one: Log, other: Log) -> None:
    a, b = (str(log.metadata.get(IDENTITY, {}).get("rate_Hz", "?")) for log in (one, other))
    for what, here, there in (("topic", one.topic, other.topic), ("rate in Hz", a, b)):
        if here != there:
            raise LogError(
                f"{what} of {one.path}: {here:.40}, of {other.path}: {there:.40}; allowed: the same"
            )


def _columns(one: Log, other: Log) -> tuple[list[Column], tuple[list[str], list[str]], list[str]]:
    """Columns of both logs; names in one log only; names of columns that differ in type or shape."""
    here, there = ({column.name: column for column in log.columns} for log in (one, other))
    both = [name for name in here if name in there]
    alike = [n for n in both if (here[n].kind, here[n].shape) == (there[n].kind, there[n].shape)]
    only = [name for name in here if name not in there], [name for name in there if name not in here]
    return [here[name] for name in alike], only, [name for name in both if name not in alike]


def read_tolerances(
    words: Sequence[str], columns: Sequence[Column], uncompared: Collection[str] = ()
) -> tuple[float, dict[str, float]]:
    """(relative tolerance of all float columns without their own, {column: absolute tolerance}).

    words : `tau=0.5`, `compute_ns=inf` (not compared), or `1e-9`, the relative tolerance. columns : compared
    columns. uncompared : names of columns in one log only or of different types; their tolerances are
    ignored, so that the same words fit logs of any release. The tolerance of `tick` is the number of ticks
    that one log may lack.

    Raises ConfigurationError: malformed words, a column that neither log has, or a tolerance other than 0 and
    inf for a column whose values have names.
    """
    known = {column.name: column for column in columns}
    relative, absolute = 0.0, dict[str, float]()
    for each in words:
        name, equals, text = each.rpartition("=")
        value = _number(text, each)
        column = known.get(name)
        if equals and column is None and name not in uncompared:
            near = get_close_matches(name, [*known, *uncompared], n=3)
            hint = f"did you mean {', '.join(near)}?" if near else "docs/guides/columns.md lists the columns"
            raise ConfigurationError(f"--tolerance {each}: neither log has a column {name!r}; {hint}")
        if column is not None and column.names and value not in (0.0, inf):
            raise ConfigurationError(
                f"--tolerance {each}: the values of {name} are names, not numbers; allowed: 0 or inf"
            )
        if equals:
            absolute[name] = value
        else:
            relative = value
    return relative, absolute


def _number(text: str, words: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if isnan(value) or value < 0.0:
        raise ConfigurationError(
            f"--tolerance {words}: allowed: COLUMN=VALUE in the column's unit, as tau=0.5, or one number, "
            "the relative tolerance of all float columns; >= 0, inf: not compared"
        )
    return value


def first_motion(log: Log) -> Origin:
    """First tick in which the platform moves. Raises LogError if it never moves."""
    for rows in log.blocks("tick", "t_ns", "mode"):
        moving = rows[np.isin(rows["mode"], [int(mode) for mode in MOVED])]
        if len(moving):
            return Origin(int(moving["tick"][0]), int(moving["t_ns"][0]))
    raise LogError(
        f"{log.path}: the platform never moves, so --align motion has no common instant; use --align tick"
    )


def _numbers(log: Log, origin: Origin) -> Ints:
    """Tick numbers (n,) of a log's rows, counted from its origin."""
    ticks = np.concatenate([np.zeros(0, np.int64), *(rows["tick"] for rows in log.blocks("tick"))])
    numbers: Ints = ticks[ticks >= origin.tick] - origin.tick
    return numbers


def _common(log: Log, names: tuple[str, ...], origin: Origin, numbers: Ints) -> Iterator[Rows]:
    """Yield the rows whose tick numbers, counted from `origin`, are in `numbers` (n,), sorted."""
    for rows in log.blocks(*names):
        own = rows["tick"] - origin.tick
        found = rows[numbers[np.searchsorted(numbers[:-1], own)] == own]
        found["t_ns"] -= origin.t_ns
        if len(found):
            yield found


def paired(one: Iterator[Rows], other: Iterator[Rows]) -> Iterator[tuple[Rows, Rows]]:
    """Yield pairs of equally long blocks of rows from two logs with equally many rows."""
    a, b = next(one, None), next(other, None)
    while a is not None and b is not None:
        n = min(len(a), len(b))
        yield a[:n], b[:n]
        a = a[n:] if len(a) > n else next(one, None)
        b = b[n:] if len(b) > n else next(other, None)


def _allowed(value: float) -> float | str:
    return value if isfinite(value) else "not judged"


def show(result: dict[str, Any]) -> None:
    """Print one line for each log column that differs; nothing if no column differs."""
    allowed = table.Column("allowed", _tolerance)
    divergences.show(result["columns"], SIDES, [allowed], lambda each: "red" if each["diverges"] else "")


def shown(result: dict[str, Any]) -> dict[str, Any]:
    """Fields of a comparison that the terminal shows below the table."""
    first = next((each["first"] for each in result["columns"] if each["diverges"]), None)
    kept = {key: value for key, value in result.items() if not key.endswith(("tolerance", "tolerances"))}
    return kept | {
        "first divergence": None if first is None else divergences.sentence(first, SIDES),
        "diverging": ", ".join(result["diverging"]) or "none",
        "columns": None,
    }


def _tolerance(each: dict[str, Any]) -> str:
    if each["tolerance"] == "not judged":
        return "any"
    if each["relative_tolerance"]:
        return f"{each['relative_tolerance']:g} relative"
    return "exact" if not each["tolerance"] else f"{each['tolerance']:g}"
