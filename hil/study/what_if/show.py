"""A what-if as plain values, and as tables."""

from collections.abc import Iterator
from typing import Any

from drivers.protocol import Frame
from drivers.signals import LEGS, Warn
from hil.loop.what_if import Answer, OtherFrames
from hil.study import divergences
from hil.study.table import Column, figure, print_rows

OPEN_LOOP = (
    "The measurements did not follow the changed forces: past the first difference the loop is open. These "
    "figures say what this controller would have answered to these measurements, not how the robot would "
    "have moved."
)
LIMITS = {str(warning.name) for warning in (Warn.FORCE_LIMIT, Warn.FORCE_STEP, Warn.FORCE_WINDOW)}
"""Warnings by which a limit of the force acts."""
SIDES = divergences.Sides("column", "what_if", "recorded")


def summary(answer: Answer, rate_Hz: float) -> dict[str, Any]:
    """Return what was found as plain values, of a loop at `rate_Hz`."""
    first = [_of_leg(divergences.place(each, each.first, SIDES)) for each in answer.columns.first]
    forces = answer.forces
    acted = answer.warnings
    return {
        "kind": "what_if",
        "note": OPEN_LOOP,
        "ticks": answer.ticks,
        "logged_s": answer.ticks / rate_Hz,
        "different_ticks": answer.different_ticks,
        "different_frames_ticks": answer.wire_different_ticks,
        "first_tick": first[0]["tick"] if first else None,
        "first": first,
        "first_frames": _frames(answer.first_frames),
        "faults_part_at_tick": answer.parts_tick,
        "recorded_faults": answer.recorded_faults,
        "what_if_faults": answer.answered_faults,
        "what_if_story": None if answer.story is None else answer.story.fields(),
        "limits": {name: each for name, each in acted.items() if name in LIMITS},
        "other_warnings": {name: each for name, each in acted.items() if name not in LIMITS},
        "forces": {
            "ticks": forces.ticks,
            "largest_N": forces.largest.tolist(),
            "at_tick": forces.at,
            "rms_N": forces.rms.tolist(),
        },
        "columns": [_column(divergences.fields(each, SIDES)) for each in answer.columns.diverging],
        "gaps": [f"{count} ticks missing from tick {tick}" for tick, count in answer.gaps],
    }


def shown(result: dict[str, Any]) -> dict[str, Any]:
    """Return what a terminal shows above the tables."""
    first = [divergences.sentence(each, SIDES) for each in result["first"]]
    limits, others = (
        [f"{name} {_ticks(each)}" for name, each in result[key].items()]
        for key in ("limits", "other_warnings")
    )
    kept = ("log", "configuration", "ticks", "answer_log", "picture", "wall_s", "times_real_time", "note")
    return {
        "success": result["success"],
        "changed": result["changed"] or "nothing",
        "different ticks": result["different_ticks"],
        "first difference": first,
        "first other frames": _frames_sentence(result["first_frames"]),
        "limits that acted": limits,
        "other warnings": others or None,
        "faults": _faults(result),
        "remarks": result["remarks"] or None,
        **{key: result[key] for key in kept},
    }


def tables(result: dict[str, Any]) -> None:
    """Print the forces by leg and the columns that differ; nothing where all is the same."""
    if not result["different_ticks"]:
        return
    forces = result["forces"]
    print(f"force, what-if less recorded, over {forces['ticks']} of {result['ticks']} ticks:")
    by_leg = (
        Column("leg", str),
        Column("largest N", lambda leg: f"{forces['largest_N'][leg]:.4g}"),
        Column("at tick", lambda leg: figure(forces["at_tick"][leg])),
        Column("RMS N", lambda leg: f"{forces['rms_N'][leg]:.4g}"),
    )
    print_rows(by_leg, range(LEGS))
    divergences.show(result["columns"], SIDES)


def story(result: dict[str, Any]) -> Iterator[str]:
    """Yield what the faults that are latched in the end have to tell."""
    if result["what_if_story"] is not None:
        yield "what the faults of the what-if have to tell:"
        yield from (f"  {line}" for line in result["what_if_story"]["lines"])


def _faults(result: dict[str, Any]) -> list[str]:
    found, there = (
        list(dict.fromkeys(f"{each['fault']} at tick {each['tick']}" for each in result[key]))
        for key in ("what_if_faults", "recorded_faults")
    )
    if not found and not there:
        return []
    lines = [f"what-if: {', '.join(found) or 'none'}", f"recorded: {', '.join(there) or 'none'}"]
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


def _of_leg(place: dict[str, Any] | None) -> dict[str, Any]:
    """Return a place with the leg whose element it is."""
    assert place is not None  # of a column that diverges
    leg = place["column"].partition(".leg_")[2]
    return place | {"leg": int(leg) if leg else None}


def _column(found: dict[str, Any]) -> dict[str, Any]:
    return found | {key: _of_leg(found[key]) for key in ("first", "at")}


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
    legs = ", ".join(map(str, found["legs"])) or "none"
    there, here = (found[key] or "none" for key in ("recorded", "what_if"))
    return f"tick {found['tick']} ({found['time_s']:.3f} s), legs {legs}: recorded {there}, what-if {here}"
