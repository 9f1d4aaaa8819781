"""`hil replay --what-if CONFIG LOG`: runs another controller on recorded measurements, in open loop."""

import contextlib
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import ConfigurationError
from drivers.frame_array import NO_FRAMES
from drivers.protocol import Frame
from drivers.signals import LEGS
from hil.app.compose import attachments, build_cycle, build_scene, databases
from hil.app.configuration.configuration import Configuration, load
from hil.app.configuration.feedforward_file import learned_forces
from hil.app.homing.last_pose import HOMING_JSON, recorded
from hil.app.output import leaving, log_path
from hil.app.readable import lacking
from hil.app.recorded_files import NAMED_FILES, REFERENCE_PLAN, with_attachments
from hil.app.replay import WHAT_IF, law_of_log, open_replayable
from hil.app.terminal import one_line
from hil.loop.clock import collector_paused
from hil.loop.cycle import Cycle
from hil.loop.replay import Block
from hil.loop.what_if import Answer, OtherFrames, what_if
from hil.record import LogSummary, Recording
from hil.record.log import Log
from hil.record.schema import IDENTITY
from hil.study import divergences
from hil.study.table import Column, figure, print_rows
from hil.study.what_if.inputs import changed, changes, refuse_other_inputs

OPEN_LOOP = (
    "The measurements do not respond to the changed forces: after the first difference the loop is open. "
    "These figures are the outputs of this controller for these measurements, not the motion that the robot "
    "would have made."
)
SIDES = ("what_if", "recorded")


def what_if_log(
    path: Path,
    config: str | None = None,
    words: Sequence[str] = (),
    *,
    out: Path | None = None,
    progress: Callable[[int], None] | None = None,
    trust_code: bool = False,
) -> dict[str, Any]:
    """Run the controller of another configuration on the inputs of a log; return the summary.

    config : a file or the name of a shipped configuration, None: the log's own. words : changes to it, as
    `controller.wn_rad_s=25`. out : log of the controller's outputs. Key `success` is True if the log could be
    read to its end: differences are no failure.

    Raises ConfigurationError: a configuration that cannot be used, or with which the inputs would have
    another meaning; LogError: as `hil.app.replay.open_replayable`, or `out` exists.
    """
    if out is not None:
        log_path("", "", out)
    log, run, own = open_replayable(path, trust_code=trust_code)
    here = changed(own if config is None else load(config), words, own=config is None)
    if config is None and here.controller.law != own.controller.law and own.law_file is not None:
        raise ConfigurationError(
            f"--set controller.law={here.controller.law}: the log contains only the law file of "
            f"{own.controller.law}; write a configuration with the other law, and give it with --what-if"
        )
    here = law_of_log(here, log, run, trust_code=trust_code)
    refuse_other_inputs(own, here, run["rate_Hz"])
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hil-what-if-")))
        given = _with_files(own, here, log, None if config is not None else folder)
        plan = log.attachments.get(REFERENCE_PLAN) if given.reference == own.reference else None
        last_pose = recorded(log.path, log.attachments.get(HOMING_JSON))
        cycle = build_cycle(given, run["rate_Hz"], run["watchdog_s"], plan, last_pose=last_pose)
        other_files = _other_files(given, log)
        recording = None if out is None else stack.enter_context(_record(here, cycle, out, log))
        stack.enter_context(collector_paused())
        begun = time.perf_counter()
        answer = _answer(log, cycle, recording, progress)
        wall_s = time.perf_counter() - begun
        end = {"reason": answer.damage, "ticks_answered": answer.ticks}
        written = None if recording is None else recording.close(end)
    return figures(answer, run["rate_Hz"]) | {
        "success": answer.whole and (written is None or written.complete),
        "trouble": _trouble(answer, written),
        "log": str(path),
        "configuration": here.source,
        "changed": [*changes(own, here), *other_files],
        "remarks": _remarks(log, answer),
        "wall_s": wall_s,
        "times_real_time": answer.ticks / run["rate_Hz"] / wall_s if wall_s > 0 else 0.0,
        "answer_log": None if out is None else str(out),
    }


def _record(here: Configuration, cycle: Cycle, path: Path, source: Log) -> Recording:
    """Start the recorder of the other controller's outputs, in step with the log. Raises LogError."""
    begins_ns = source.origin_ns
    recording = Recording.start(
        path,
        configuration=here.text,
        attachments=databases(here),
        metadata={
            "kind": WHAT_IF,
            "what_if_of": source.path.name,
            "what_if_of_kind": source.metadata.get(IDENTITY, {}).get("kind", ""),
            "open_loop": OPEN_LOOP,
            "rate_Hz": cycle.parts.rate_Hz,
            "watchdog_s": cycle.parts.setup.watchdog_s,
            "protocol": here.drives.protocol,
        },
        scene=build_scene(here),
        can_channel=source.can_channels,
        lockstep=True,
        ring_ticks=here.recording.ring_ticks,
    )
    recording.event(begins_ns, "warning", f"a what-if on {source.path.name}, not a run. {OPEN_LOOP}")
    return recording


def _answer(
    log: Log,
    cycle: Cycle,
    recording: Recording | None,
    progress: Callable[[int], None] | None,
) -> Answer:
    def observe(block: Block) -> None:
        assert recording is not None
        rows, frames, ends = block.ticks.recorded(block.span)
        entry = block.entries[0]
        given = entry.operator, entry.setpoints, entry.orders
        if any(given):
            recording.tick(rows[0], frames, NO_FRAMES, *given)
        else:
            recording.ticks_of_items(rows, frames, ends)

    there = "" if recording is None else f"its outputs until then: {recording.path}"
    with leaving(lambda: there), np.errstate(all="ignore"):  # a diverging law ends in its fault
        return what_if(log, cycle, observe=observe if recording else None, progress=progress)


def _with_files(own: Configuration, here: Configuration, log: Log, folder: Path | None) -> Configuration:
    """Configuration with its files: the log's own configuration, if changed, reads the files in the log.

    folder : where these files are written, None: the configuration has a folder of its own.

    Raises ConfigurationError: changes name a file, or do not fit the learned feed-forward.
    """
    if folder is None:
        return here
    for _, section, key, kind, _ in NAMED_FILES:
        there, given = getattr(own, section), getattr(here, section)
        if isinstance(given, kind) and getattr(there, key, None) != getattr(given, key):
            raise ConfigurationError(
                f"--set {section}.{key}={getattr(given, key)}: the configuration in a log cannot refer to a "
                "file on disk; write a configuration with it, and give it with --what-if"
            )
    given = with_attachments(here, log.attachments, folder)
    try:
        learned_forces(given.feedforward, given.reference, given.controller, given.platform, given.folder)
    except ConfigurationError as error:
        problems = (text.replace(str(folder), str(log.path)) for text in error.problems)
        raise ConfigurationError(
            *problems, "For a what-if without these forces add --set feedforward="
        ) from None
    return given


def _other_files(here: Configuration, log: Log) -> list[str]:
    """Files of a configuration whose content differs from the log's."""
    there, given = log.attachments, dict(attachments(here))
    return [
        f"{section}.{key}: the content of the file differs from the log's"
        for name, section, key, *_ in NAMED_FILES
        if name in there and there[name] != given.get(name, there[name])
    ]


def _trouble(answer: Answer, written: LogSummary | None) -> str | None:
    found = [one_line(answer.damage)] if answer.damage else []
    found += [
        f"{count} ticks missing from tick {tick} on; the what-if ends there" for tick, count in answer.gaps
    ]
    if not answer.ticks and not found:
        found.append("the log has no tick")
    if written is not None and written.error:
        found.append(written.error)
    return "; ".join(found) or None


def _remarks(log: Log, answer: Answer) -> list[str]:
    """Remarks on how far the figures of the other controller are valid."""
    found = [missing] if (missing := lacking(log)) else []
    frames = answer.first_frames
    if frames is not None and any(each["tick"] > frames.tick for each in answer.answered_faults):
        found.append(
            f"a fault after tick {frames.tick} may be caused by the open loop alone: encoders, brakes, "
            "tracking error and certificate are compared with the motion expected from the forces sent"
        )
    return found


def figures(answer: Answer, rate_Hz: float) -> dict[str, Any]:
    """Differences between recorded and recomputed outputs as plain values; rate_Hz: rate of the loop."""
    first = [divergences.place(each, each.first, SIDES) for each in answer.columns.first]
    forces = answer.forces
    return {
        "kind": "what_if",
        "note": OPEN_LOOP,
        "ticks": answer.ticks,
        "logged_s": answer.ticks / rate_Hz,
        "different_ticks": answer.different_ticks,
        "different_frames_ticks": answer.wire_different_ticks,
        "first_tick": first[0]["tick"] if first and first[0] else None,
        "first": first,
        "first_frames": _frames(answer.first_frames),
        "faults_part_at_tick": answer.parts_tick,
        "recorded_faults": answer.recorded_faults,
        "what_if_faults": answer.answered_faults,
        "what_if_story": None if answer.story is None else answer.story.fields(),
        "warnings": answer.warnings,
        "forces": {
            "ticks": forces.ticks,
            "largest_N": forces.largest.tolist(),
            "at_tick": forces.at,
            "rms_N": forces.rms.tolist(),
        },
        "columns": [divergences.fields(each, SIDES) for each in answer.columns.diverging],
        "gaps": [f"{count} ticks missing from tick {tick}" for tick, count in answer.gaps],
    }


def _frames(found: OtherFrames | None) -> dict[str, Any] | None:
    if found is None:
        return None
    values = {"recorded": _frame(found.recorded), "what_if": _frame(found.answered)}
    return {"tick": found.tick, "time_s": found.time_s, "legs": list(found.legs), **values}


def _frame(frame: Frame | None) -> str | None:
    return None if frame is None else f"0x{frame.id:X} {frame.data.hex(' ')}"


def shown(result: dict[str, Any]) -> dict[str, Any]:
    """Lines about the other controller's outputs that the terminal shows below the tables."""
    warnings = [
        f"{name} in {each['answered']} ticks, in {each['recorded']} ticks of the log"
        + (
            ""
            if each["first_tick"] is None
            else f", first without one in the log at tick {each['first_tick']}"
        )
        for name, each in result["warnings"].items()
    ]
    frames = result["first_frames"]
    kept = ("log", "configuration", "ticks", "answer_log", "wall_s", "times_real_time", "note")
    return {
        "success": result["success"],
        "changed": result["changed"] or "nothing",
        "different ticks": result["different_ticks"],
        "first difference": [divergences.sentence(each, SIDES) for each in result["first"]],
        "first other frames": "none: all frames would have been the same"
        if frames is None
        else f"tick {frames['tick']} ({frames['time_s']:.3f} s), legs {', '.join(map(str, frames['legs']))}: "
        f"recorded {frames['recorded']}, what-if {frames['what_if']}",
        "limits and warnings": warnings,
        "faults": _faults(result),
        "remarks": result["remarks"] or None,
        **{key: result[key] for key in kept},
    }


def _faults(result: dict[str, Any]) -> list[str]:
    lines = []
    for name in SIDES:
        named = dict.fromkeys(f"{each['fault']} at tick {each['tick']}" for each in result[f"{name}_faults"])
        lines += [f"{name.replace('_', '-')}: {', '.join(named)}"] if named else []
    tick = result["faults_part_at_tick"]
    if tick is not None:
        lines.append(
            f"from tick {tick} on only one of the two has a fault: {result['forces']['ticks']} "
            "ticks before it are compared"
        )
    return lines


def tables(result: dict[str, Any]) -> None:
    """Print force differences by leg and the differing columns; nothing if there is no difference."""
    if not result["different_ticks"]:
        return
    forces = result["forces"]
    print(f"force, what-if minus recorded, over {forces['ticks']} of {result['ticks']} ticks:")
    by_leg = (
        Column("leg", str),
        Column("largest N", lambda leg: f"{forces['largest_N'][leg]:.4g}"),
        Column("at tick", lambda leg: figure(forces["at_tick"][leg])),
        Column("RMS N", lambda leg: f"{forces['rms_N'][leg]:.4g}"),
    )
    print_rows(by_leg, range(LEGS))
    divergences.show(result["columns"], SIDES)


def story(result: dict[str, Any]) -> Iterator[str]:
    """Yield text lines that explain the other controller's faults."""
    if result["what_if_story"] is not None:
        yield "faults of the what-if:"
        yield from (f"  {line}" for line in result["what_if_story"]["lines"])
