"""A what-if as plain values, and as tables."""

from collections.abc import Iterator
from typing import Any

from drivers.protocol import Frame
from drivers.signals import LEGS, Warn
from hil.app.output import print_table
from hil.loop.what_if import Answer, OtherFrames
from hil.record.divergence import ColumnDivergence, Place
from hil.study.table import results
from hil.study.what_if.recorded import OPEN_LOOP

LIMITS = (Warn.FORCE_LIMIT, Warn.FORCE_STEP, Warn.FORCE_WINDOW)
"""Warnings by which a limit of the force acts."""
COLUMNS = ("column", "from tick", "in ticks", "largest", "unit", "at tick")
SHOWN = 12
"""Columns and changes that a terminal shows; the JSON file has all."""


def summary(answer: Answer, rate_Hz: float) -> dict[str, Any]:
    """Return what was found as plain values, of a loop at `rate_Hz`."""
    first = answer.columns.first
    forces = answer.forces
    names = {str(warning.name) for warning in LIMITS}
    acted = {name: each._asdict() for name, each in answer.warnings.items()}
    return {
        "kind": "what_if",
        "note": OPEN_LOOP,
        "ticks": answer.ticks,
        "logged_s": answer.ticks / rate_Hz,
        "different_ticks": answer.different_ticks,
        "different_frames_ticks": answer.wire_different_ticks,
        "first_tick": first[0].first.tick if first and first[0].first else None,
        "first": [_place(each, each.first) for each in first],
        "first_frames": _frames(answer.first_frames),
        "faults_part_at_tick": answer.parts_tick,
        "recorded_faults": [each._asdict() for each in answer.recorded_faults],
        "what_if_faults": answer.answered_faults,
        "what_if_story": None if answer.story is None else answer.story.fields(),
        "limits": {name: each for name, each in acted.items() if name in names},
        "other_warnings": {name: each for name, each in acted.items() if name not in names},
        "forces": {
            "ticks": forces.ticks,
            "largest_N": forces.largest.tolist(),
            "at_tick": forces.at,
            "rms_N": forces.rms.tolist(),
        },
        "columns": [_column(each) for each in answer.columns.diverging],
        "gaps": [f"{count} ticks missing from tick {tick}" for tick, count in answer.gaps],
    }


def closing(answer: Answer) -> dict[str, object]:
    """Return what a log of it says of its end."""
    return {"reason": answer.damage, "ticks_answered": answer.ticks}


def shown(result: dict[str, Any]) -> dict[str, Any]:
    """Return what a terminal shows above the tables."""
    changed = result["changed"]
    more = [f"and {len(changed) - SHOWN} more"] if len(changed) > SHOWN else []
    limits = [f"{name} {_ticks(each)}" for name, each in result["limits"].items()]
    others = [f"{name} {_ticks(each)}" for name, each in result["other_warnings"].items()]
    first = [_sentence(each) for each in result["first"]]
    return {
        "success": result["success"],
        "log": result["log"],
        "configuration": result["configuration"],
        "changed": [*changed[:SHOWN], *more] or "nothing",
        "ticks": result["ticks"],
        "different ticks": result["different_ticks"],
        "first difference": first[:3] + ([f"{len(first) - 3} more columns"] if len(first) > 3 else []),
        "first other frames": _frames_sentence(result["first_frames"]),
        "limits that acted": limits,
        "other warnings": others or None,
        "faults": _faults(result),
        "answer_log": result["answer_log"],
        "picture": result["picture"],
        "remarks": result["remarks"] or None,
        "wall_s": result["wall_s"],
        "times_real_time": result["times_real_time"],
        "note": result["note"],
    }


def tables(result: dict[str, Any]) -> None:
    """Print the forces by leg and the columns that differ; nothing where all is the same."""
    if not result["different_ticks"]:
        return
    forces = result["forces"]
    table = results("leg", "largest N", "at tick", "RMS N")
    for leg in range(LEGS):
        at = forces["at_tick"][leg]
        cells = (
            f"{forces['largest_N'][leg]:.4g}",
            "-" if at is None else str(at),
            f"{forces['rms_N'][leg]:.4g}",
        )
        table.add_row(str(leg), *cells)
    print(f"force, what-if less recorded, over {forces['ticks']} of {result['ticks']} ticks:")
    print_table(table)
    columns = result["columns"]
    if columns:
        table = results(*COLUMNS, left=("column", "unit"))
        for each in columns[:SHOWN]:
            at = each["at"]
            largest = "-" if each["largest"] is None else f"{each['largest']:.4g}"
            first = str(each["first"]["tick"])
            table.add_row(each["column"], first, str(each["ticks"]), largest, each["unit"], str(at["tick"]))
        print_table(table)
    if len(columns) > SHOWN:
        print(f"{len(columns) - SHOWN} more columns differ: --json FILE has all")


def story(result: dict[str, Any]) -> Iterator[str]:
    """Yield what the faults that are latched in the end have to tell."""
    if result["what_if_story"] is not None:
        yield "what the faults of the what-if have to tell:"
        for line in result["what_if_story"]["lines"]:
            yield f"  {line}"


def _faults(result: dict[str, Any]) -> list[str]:
    found = [f"{each['fault']} at tick {each['tick']}" for each in result["what_if_faults"]]
    there = [f"{each['fault']} at tick {each['tick']}" for each in result["recorded_faults"]]
    if not found and not there:
        return []
    lines = [
        f"what-if: {', '.join(dict.fromkeys(found)) or 'none'}",
        f"recorded: {', '.join(there) or 'none'}",
    ]
    tick = result["faults_part_at_tick"]
    if tick is not None:
        lines.append(
            f"from tick {tick} on one of the two has faulted and the other not: {result['forces']['ticks']} "
            "ticks are compared until then"
        )
    return lines


def _ticks(acted: dict[str, Any]) -> str:
    words = f"in {acted['answered']} ticks, in the log in {acted['recorded']}"
    first = acted["first_tick"]
    return words if first is None else f"{words}, first of its own at tick {first}"


def _place(found: ColumnDivergence, place: Place | None) -> dict[str, Any] | None:
    if place is None:
        return None
    answered, recorded = place.values(found.column)
    leg = place.label.partition(".leg_")[2]
    return {
        "tick": place.tick, "time_s": place.time_s, "column": place.label, "leg": int(leg) if leg else None,
        "recorded": recorded, "what_if": answered, "unit": place.unit,
    }  # fmt: skip


def _column(found: ColumnDivergence) -> dict[str, Any]:
    column = found.column
    return {
        "column": column.name, "unit": column.unit, "ticks": found.ticks,
        "largest": None if column.names else found.largest,
        "first": _place(found, found.first), "at": _place(found, found.at),
    }  # fmt: skip


def _sentence(first: dict[str, Any]) -> str:
    return (
        f"tick {first['tick']} ({first['time_s']:.3f} s): {first['column']}: recorded {first['recorded']}, "
        f"what-if {first['what_if']} {first['unit']}".rstrip()
    )


def _frames(found: OtherFrames | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "tick": found.tick, "time_s": found.time_s, "legs": list(found.legs),
        "recorded": _frame(found.recorded), "what_if": _frame(found.answered),
    }  # fmt: skip


def _frame(frame: Frame | None) -> str | None:
    return None if frame is None else f"0x{frame.id:X} {frame.data.hex(' ')}"


def _frames_sentence(found: dict[str, Any] | None) -> str:
    if found is None:
        return "none: every tick would have sent the same"
    legs = found["legs"]
    whom = "all legs" if len(legs) == LEGS else f"leg {', '.join(map(str, legs))}" if legs else "no leg"
    there, here = (found[key] or "none" for key in ("recorded", "what_if"))
    return f"tick {found['tick']} ({found['time_s']:.3f} s), for {whom}: recorded {there}, what-if {here}"
