"""`hil learn CONFIG --runs N`: run, learn, run again, in simulated time."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from drivers.errors import ConfigurationError, HilError
from hil.app.check.command import refuse_unreachable
from hil.app.configuration.changes import unattended, with_changes
from hil.app.configuration.configuration import Configuration, loads
from hil.app.sim.command import simulate
from hil.lab.identify.runs import refuse_fused
from hil.lab.learn.command import Knowledge, Outcome, Step, learned, limit_of
from hil.lab.learn.runs import LearningRun, learning_run


class Rehearsal(NamedTuple):
    """What became of a series of runs."""

    steps: list[Step]
    outcome: Outcome | None
    """Of the last run that could be learned from; None where the first one failed."""
    limit_N: float
    best: str
    """Text of the file of the run with the smallest error; empty where that is the one without any."""
    trouble: str
    """Why a run failed, or that it was interrupted; empty where none was."""
    interrupted: bool


def rehearse(
    c: Configuration, runs: int, known: Knowledge, folder: Path, tell: Callable[[Step], None]
) -> Rehearsal:
    """Make up to so many runs in lockstep, each with what the one before has taught; logs go into a folder.

    It ends early at the floor, where a run contradicts the condition, where one fails, cannot begin or cannot
    teach, and by an interrupt behind the first run.

    Raises what keeps the first run from being made or learned from: ConfigurationError, LogError, PlantError,
    ModelError, OSError.
    """
    c.require("sim")
    refuse_fused(c, c.source, "learn")
    c = unattended(c)
    refuse_unreachable(c)
    if known.limit_N is None and c.feedforward is not None:
        known = known._replace(limit_N=c.feedforward.limit_N)
    text, limit_N, trouble, interrupted = "", 0.0, "", False
    past: list[LearningRun] = []
    steps: list[Step] = []
    texts: list[str] = []
    outcome: Outcome | None = None
    try:
        for number in range(runs):
            log = folder / f"{c.name}-run-{number:02d}.mcap"
            file = folder / f"{c.name}-run-{number:02d}.csv"
            try:
                made = simulate(_with(c, text, file, limit_N), log=log, check_replay=False)
                if not made["success"]:
                    why = made["trouble"] or ", ".join(made["faults"])
                    trouble = f"run {number}: {why}; --logs FOLDER keeps its log"
                    break
                past = [*past[-1:], learning_run(log)]
                limit_N = limit_of(past[-1], known)
                outcome = learned(past, known)
            except (HilError, OSError) as error:
                if not steps:
                    raise
                trouble = f"run {number}: {error}"
                break
            texts.append(text)
            steps.append(outcome.steps[-1])
            tell(steps[-1])
            if outcome.state != "learned":
                break
            text = outcome.text
    except KeyboardInterrupt:
        if not steps:
            raise
        trouble, interrupted = f"run {number}: interrupted", True
    best = min(range(len(steps)), key=lambda k: steps[k].rms_mm, default=0)
    return Rehearsal(steps, outcome, limit_N, texts[best] if texts else "", trouble, interrupted)


def _with(c: Configuration, text: str, path: Path, limit_N: float) -> Configuration:
    """Return the configuration with a feed-forward of this text; without any where the text is empty."""
    section: dict[str, Any] | None = None
    if text:
        path.write_text(text, encoding="utf-8")
        section = {"file": str(path.absolute()), "limit_N": limit_N}
    return loads(with_changes(c.text, {"name": c.name, "feedforward": section}), c.source, c.folder)


def with_scale(c: Configuration, scale: float) -> Configuration:
    """Return the configuration with its law's masses scaled. Raises ConfigurationError: no model."""
    believed = c.controller.believed
    if believed is None or "model" not in type(c.controller).model_fields:
        raise ConfigurationError(f"--inertia-scale: law {c.controller.law} has no model of the masses")
    change = {"controller": {"model": {"inertia_scale": scale * believed.inertia_scale}}, "name": c.name}
    return loads(with_changes(c.text, change), c.source, c.folder)
