"""`hil replay --what-if CONFIG LOG`: another controller on the recorded measurements."""

import contextlib
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import ConfigurationError, LogError
from drivers.frame_array import NO_FRAMES
from hil.app.compose import (
    CONTROLLER_FILE,
    FEEDFORWARD_CSV,
    REFERENCE_CSV,
    REFERENCE_PLAN,
    attachments,
    build_cycle,
)
from hil.app.configuration.configuration import Configuration, load
from hil.app.configuration.feedforward_file import learned_forces
from hil.app.files import PICTURE, beginning, new_file, printable
from hil.app.homing.last_pose import HOMING_JSON, recorded
from hil.app.output import further, log_path
from hil.app.readable import lacking
from hil.app.recorded_files import with_attachments
from hil.app.replay import law_of_log, open_replayable
from hil.app.terminal import one_line
from hil.config.feedforward import FeedforwardSettings
from hil.config.reference import LiveReference, SampledReference
from hil.control.state_space import StateSpaceSettings
from hil.loop.clock import collector_paused
from hil.loop.cycle import Cycle
from hil.loop.replay import Block
from hil.loop.what_if import Answer, what_if
from hil.record import LogSummary, Recording, environment
from hil.record.log import Log
from hil.record.schema import ENVIRONMENT
from hil.study.plot.command import SUFFIXES
from hil.study.what_if import show
from hil.study.what_if.allowed import changes, refuse_other_inputs
from hil.study.what_if.changes import changed
from hil.study.what_if.picture import Forces
from hil.study.what_if.recorded import record

FILES = (
    (REFERENCE_CSV, "reference", "path", SampledReference),
    (CONTROLLER_FILE, "controller", "controller_file", StateSpaceSettings),
    (FEEDFORWARD_CSV, "feedforward", "file", FeedforwardSettings),
)
"""Files that a controller reads: name in a log, section and key that name it, settings that have this key."""


def what_if_log(
    path: Path,
    config: str | None = None,
    words: Sequence[str] = (),
    *,
    picture: Path | None = None,
    out: Path | None = None,
    progress: Callable[[int], None] | None = None,
    trust_code: bool = False,
) -> dict[str, Any]:
    """Give the controller of another configuration the inputs of a log, and return what it answers.

    config : a file or the name of a shipped configuration, None: the log's own; words : changes to it, as
    `controller.wn_rad_s=25`; picture : PNG or SVG of the forces; out : a log of what it answers. Key
    `success` tells whether the log could be read to its end: differences are no failure.

    Raises ConfigurationError: a configuration that cannot be used, or to which the inputs mean something
    else; LogError: as `hil.app.replay.open_replayable`, or a file that exists.
    """
    if picture is not None:
        new_picture(picture)
    if out is not None:
        log_path("", "", out)
    log, run, own = open_replayable(path, trust_code=trust_code)
    here = changed(own if config is None else load(config), words, own=config is None)
    if config is None and here.controller.law != own.controller.law and own.law_file is not None:
        raise ConfigurationError(
            f"--set controller.law={here.controller.law}: the log carries {own.controller.law} alone; write "
            "a configuration with the other law, and name it with --what-if"
        )
    here = law_of_log(here, log, run, trust_code=trust_code)
    refuse_other_inputs(own, here, run["rate_Hz"])
    forces = None if picture is None else Forces()
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hil-what-if-")))
        given = _with_files(own, here, log, None if config is not None else folder)
        cycle = _cycle(log, run, own, given)
        other_files = _other_files(given, log)
        recording = None if out is None else stack.enter_context(record(here, cycle, out, log))
        stack.enter_context(collector_paused())
        begun = time.perf_counter()
        answer = _answer(log, cycle, recording, forces, progress)
        wall_s = time.perf_counter() - begun
        written = None if recording is None else recording.close(show.closing(answer))
    result = show.summary(answer, run["rate_Hz"])
    result |= {
        "success": answer.whole and (written is None or written.complete),
        "trouble": _trouble(answer, written),
        "log": str(path),
        "configuration": here.source,
        "changed": [*changes(own, here), *other_files],
        "remarks": _remarks(log, here, answer, cycle),
        "wall_s": wall_s,
        "times_real_time": answer.ticks / run["rate_Hz"] / wall_s if wall_s > 0 else 0.0,
        "answer_log": None if out is None else str(out),
        "picture": None,
    }
    if forces is not None and picture is not None and answer.ticks:
        with further(result):
            forces.draw(
                picture, f"{printable(path.name)}: recorded, and what {_named(here, words)} would have sent"
            )
            result["picture"] = str(picture)
    return result


def _named(here: Configuration, words: Sequence[str]) -> str:
    """Return what a controller is called in a picture."""
    return printable(" ".join((here.name, *words)))


def new_picture(path: Path) -> None:
    """Refuse a picture that could not be drawn; an earlier one is replaced. Raises LogError."""
    if path.suffix.lower() not in SUFFIXES:
        raise LogError(f"--plot {path}: allowed are the endings {' and '.join(SUFFIXES)}")
    own = PICTURE if path.suffix.lower() == ".png" else beginning("an SVG picture", b"<?xml")
    new_file(path, option="--plot", own=own)


def _answer(
    log: Log,
    cycle: Cycle,
    recording: Recording | None,
    forces: Forces | None,
    progress: Callable[[int], None] | None,
) -> Answer:
    def observe(block: Block) -> None:
        assert recording is not None
        rows, frames, ends = block.ticks.recorded(block.span)
        entry = block.entries[0]
        given = entry.operator, entry.setpoints, entry.orders
        if any(given):
            recording.tick_of_items(rows[0], frames, NO_FRAMES, *given)
        else:
            recording.ticks_of_items(rows, frames, ends)

    keep = None if forces is None else forces.keep
    try:
        with np.errstate(all="ignore"):  # a law that diverges says so by its fault
            return what_if(log, cycle, observe=observe if recording else None, keep=keep, progress=progress)
    except KeyboardInterrupt:
        if recording is None:
            raise
        recording.close({"reason": "interrupted"})
        raise KeyboardInterrupt(f"what it answered until then: {recording.path}") from None


def _with_files(own: Configuration, here: Configuration, log: Log, folder: Path | None) -> Configuration:
    """Return a configuration whose files are there: changes of the log's own one take those of the log.

    folder : where these go, None: the configuration has a folder of its own.
    """
    if folder is None:
        return here
    _refuse_new_files(own, here)
    given = with_attachments(here, log.attachments, folder)
    _refuse_untaught(given, log)
    return given


def _other_files(here: Configuration, log: Log) -> list[str]:
    """Return which files of a configuration have another content than those of the log."""
    there = log.attachments
    return [
        f"{section}.{key}: the file has another content than that of the log"
        for name, section, key, _ in FILES
        if name in there and there[name] != dict(attachments(here)).get(name, there[name])
    ]


def _cycle(log: Log, run: dict[str, Any], own: Configuration, here: Configuration) -> Cycle:
    """Return the controller of `here`, as the run of a log would have begun with it.

    Where the reference is the log's, so is its plan.
    """
    plan = log.attachments.get(REFERENCE_PLAN) if here.reference == own.reference else None
    last_pose = recorded(log.path, log.attachments.get(HOMING_JSON))
    return build_cycle(here, run["rate_Hz"], run["watchdog_s"], plan, last_pose=last_pose)


def _refuse_new_files(own: Configuration, here: Configuration) -> None:
    """Refuse changes to a log's own configuration that name a file: it has a folder no more."""
    for _, section, key, kind in FILES:
        there, given = getattr(own, section), getattr(here, section)
        if not isinstance(given, kind):
            continue
        if not isinstance(there, kind) or getattr(there, key) != getattr(given, key):
            raise ConfigurationError(
                f"--set {section}.{key}={getattr(given, key)}: the configuration in a log names no file on "
                "this disk; write a configuration that does, and name it with --what-if"
            )


def _refuse_untaught(given: Configuration, log: Log) -> None:
    """Refuse changes to a log's own configuration with which its learned feed-forward does not go."""
    taught = given.feedforward
    try:
        learned_forces(taught, given.reference, given.controller, given.platform, given.folder)
    except ConfigurationError as error:
        assert taught is not None  # without one there is nothing to refuse
        raise ConfigurationError(
            *(text.replace(taught.file, f"{log.path}:{FEEDFORWARD_CSV}") for text in error.problems),
            "For a what-if without these forces add --set feedforward=",
        ) from None


def _trouble(answer: Answer, written: LogSummary | None) -> str | None:
    found = [one_line(answer.damage)] if answer.damage else []
    found += [
        f"{count} ticks missing from tick {tick}: nothing after is answered" for tick, count in answer.gaps
    ]
    if not answer.ticks and not found:
        found.append("the log has no tick")
    if written is not None and written.error:
        found.append(written.error)
    return "; ".join(found) or None


def _remarks(log: Log, here: Configuration, answer: Answer, cycle: Cycle) -> list[str]:
    """Return what else is to be known of the figures."""
    found: list[str] = []
    missing = lacking(log)
    if missing:
        found.append(missing)
    there, own = log.metadata.get(ENVIRONMENT, {}), environment()
    names = {"version": "version", "git": "state of the sources", "cpu": "CPU"}
    other = [name for key, name in names.items() if there.get(key) != own.get(key)]
    if other:
        found.append(
            f"the log was made with another {', '.join(other)}: `hil replay` without --what-if says how much "
            "of the differences comes of that"
        )
    if answer.setpoints and not isinstance(here.reference, LiveReference):
        found.append(
            f"the {answer.setpoints} set-points of the log are not followed: reference.type "
            f"{here.reference.type} takes none"
        )
    frames = answer.first_frames
    if frames is not None and any(each["tick"] > frames.tick for each in answer.answered_faults):
        found.append(
            f"a fault after tick {frames.tick} may come of the open loop alone: encoders, brakes, following "
            "error and certificate are judged by the motion that the forces sent should bring about"
        )
    if cycle.mode.name != answer.last_mode:
        found.append(
            f"at the end of the log it is in {cycle.mode.name}, the recorded one in {answer.last_mode}"
        )
    return found
