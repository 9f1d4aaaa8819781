"""`hil learn`: computes the feed-forward forces of the next run, from logs or from simulated runs."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError, HilError, LogError
from hil.app.check.command import refuse_unreachable
from hil.app.configuration.changes import unattended, with_changes
from hil.app.configuration.configuration import Configuration, loads
from hil.app.configuration.feedforward_file import MOST_BYTES, feedforward_text, largest_written
from hil.app.derive_encoder_limits import leg_errors
from hil.app.sim.command import simulate
from hil.config.feedforward import FeedforwardHead, MadeFor
from hil.lab.identify.runs import refuse_fused
from hil.lab.learn.judgement import Contradiction, Floor, State, contradiction, floor, in_band, state
from hil.lab.learn.model import Learner, belief_of, learner
from hil.lab.learn.runs import LearningRun, learning_run
from hil.lab.learn.trial import FIRST_STEP, predicted, updated

LIMIT_SHARE = 0.2
"""Default for the largest learned force, as a share of limits.force_N."""


class Knowledge(NamedTuple):
    """The user's bounds of the plant's uncertainty, and the limit of the learned force."""

    axes: Path | None = None
    """File of `hil identify`; None: the configuration's delays, with the two errors below."""
    gain_error: float = 0.25
    delay_error_s: float = 1e-3
    limit_N: float | None = None


class Step(NamedTuple):
    """One run of a learning series with its tracking error, measured and predicted."""

    run: LearningRun
    rms_mm: float
    peak_mm: float
    in_band_mm: float
    predicted_mm: float | None
    """Prediction by the nominal axes; None for the first run."""
    contraction: float | None
    """Ratio of the in-band error to that of the run before; None for the first run."""
    learned_peak_N: float
    contradicted: Contradiction | None


class Outcome(NamedTuple):
    """Result of learning from consecutive runs: the next feed-forward, or the reason to stop."""

    steps: list[Step]
    learner: Learner
    floor: Floor
    state: State
    text: str
    """Text of the next feed-forward file; empty unless `state` is learned."""
    cut: int
    """Number of rows in which a learned force was clipped at its limit."""
    predicted_mm: float
    """Error of the next run by the nominal axes, with the forces cut at the limit."""


class Series(NamedTuple):
    """Result of a learning series, from logs or from runs simulated one after the other."""

    steps: list[Step]
    outcome: Outcome | None
    """Result for the last usable run; None if the first run failed."""
    limit_N: float
    best: str
    """Text of the file to write: learned from logs, or of the simulated run with the smallest error."""
    trouble: str = ""
    """Failure of a run, or its interruption; empty without any."""
    interrupted: bool = False


def learn(paths: Sequence[Path], known: Knowledge) -> Series:
    """Learn from the logs of consecutive runs, ending with the newest. Raises the errors of `learned`."""
    outcome = learned([learning_run(path) for path in paths], known)
    return Series(outcome.steps, outcome, limit_of(outcome.steps[-1].run, known), outcome.text)


def learned(runs: Sequence[LearningRun], known: Knowledge) -> Outcome:
    """Compute the next feed-forward forces from consecutive runs.

    Raises LogError for logs that are unusable or not consecutive, ConfigurationError for a law without a
    known linear loop, ModelError if no filter makes the error fall.
    """
    _require_consecutive(runs)
    last = runs[-1]
    c, samples = last.configuration, len(last.trial.e)
    model = learner(c, belief_of(c, known.axes, known.gain_error, known.delay_error_s), samples)
    noise = leg_errors(c)
    first_rms_m = runs[0].trial.rms_m if runs[0].head is None else 1e-3 * runs[0].head.first_rms_error_mm
    steps = [
        _step(before, now, model, first_rms_m, noise.length_std_m)
        for before, now in zip([None, *runs[:-1]], runs, strict=True)
    ]
    unexplained = None if len(runs) == 1 else last.trial.tracked - expected(runs[-2], last, model)
    loops, Q, newest = model.loops, model.choice.Q, steps[-1]
    least = floor(last.trial, unexplained, loops, Q, model.f_Hz, noise.length_std_m, noise.rate_std_m_s)
    measured_m = float(np.hypot(least.encoder_m, least.rate_m))
    goes = state(newest.contradicted is not None, 1e-3 * newest.in_band_mm, newest.contraction, measured_m)
    a = updated(last.trial, loops, Q, model.f_Hz, FIRST_STEP if last.number == 0 else 1.0)
    tau = np.einsum("nij,nj->ni", last.force_per_acceleration, a)
    limit_N = limit_of(last, known)
    cut, most, text = int((np.abs(tau) > limit_N).any(axis=1).sum()), largest_written(limit_N), ""
    tau = np.clip(tau, -most, most)
    if goes == "learned":
        head = _head(last, model, first_rms_m, tau)
        text = feedforward_text(head, tau, -last.trial.lead, last.trial.period_s)
        if len(text) > MOST_BYTES:
            raise LogError(
                f"{last.path}: its feed-forward takes {len(text)} bytes, allowed: {MOST_BYTES}; learn on a "
                "shorter reference"
            )
    acts = np.linalg.solve(last.force_per_acceleration, tau[:, :, None])[:, :, 0]
    ahead = 1e3 * _rms(predicted(last.trial, acts, loops))
    return Outcome(steps, model, least, goes, text, cut, ahead)


def limit_of(run: LearningRun, known: Knowledge) -> float:
    """Largest learned force, N: from the user, the configuration, or LIMIT_SHARE of limits.force_N."""
    if known.limit_N is not None:
        return known.limit_N
    settings = run.configuration.feedforward
    return LIMIT_SHARE * run.configuration.limits.force_N if settings is None else settings.limit_N


def expected(before: LearningRun, now: LearningRun, model: Learner) -> Array:
    """Tracking errors (count, 6) m that the nominal plant predicts for a run, from the run before."""
    t, begun = now.trial, before.trial.first - before.trial.lead
    return predicted(before.trial, t.a[begun : t.first + t.length], model.loops)


def _step(
    before: LearningRun | None, now: LearningRun, model: Learner, first_rms_m: float, noise_m: float
) -> Step:
    Q, f = model.choice.Q, model.f_Hz
    inside = _rms(in_band(now.trial, Q, f))
    found = ahead = factor = None
    if before is not None:
        ahead = 1e3 * _rms(expected(before, now, model))
        factor = inside / max(_rms(in_band(before.trial, Q, f)), 1e-12)
        found = contradiction(
            before.trial, now.trial, model.loops, model.c, Q, f, first_rms_m=first_rms_m, noise_m=noise_m
        )
    peak_N = float(np.abs(now.tau_learned).max())
    t = now.trial
    return Step(now, 1e3 * t.rms_m, 1e3 * t.peak_m, 1e3 * inside, ahead, factor, peak_N, found)


def _require_consecutive(runs: Sequence[LearningRun]) -> None:
    first = runs[0]
    if len(runs) == 1 and first.number > 0:
        raise LogError(
            f"{first.path}: its feed-forward was learned from {first.number} run(s): give the log of the run "
            "before, too, to compare the error with its prediction"
        )
    for before, now in pairwise(runs):
        same = {
            what: (getattr(before.made_for, what), getattr(now.made_for, what))
            for what in MadeFor.model_fields
        }
        same["rate"] = 1.0 / before.trial.period_s, 1.0 / now.trial.period_s
        same["number of ticks"] = len(before.trial.e), len(now.trial.e)
        for what, (there, here) in same.items():
            if here != there:
                raise LogError(
                    f"{now.path}: its {what}, {here}, differs from {there} in {before.path}: "
                    "learning needs equal runs"
                )
        if now.number != before.number + 1:
            raise LogError(
                f"{now.path}: its feed-forward was learned from {now.number} run(s), that of {before.path} "
                f"from {before.number}, allowed: consecutive runs in their order, the last one with one more"
            )


def _head(last: LearningRun, model: Learner, first_rms_m: float, tau: Array) -> FeedforwardHead:
    return FeedforwardHead(
        kind="feedforward",
        source=last.path.name,
        run=last.number + 1,
        made_for=last.made_for,
        rate_Hz=last.configuration.loop.rate_Hz,
        cutoff_Hz=_rounded(model.choice.Q.end_Hz),
        contraction=_rounded(model.choice.contraction),
        first_rms_error_mm=_rounded(1e3 * first_rms_m),
        rms_error_mm=_rounded(1e3 * last.trial.rms_m),
        peak_N=_rounded(float(np.abs(tau).max())),
        rows=len(tau),
    )


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")


def _rms(x: Array) -> float:
    return float(np.sqrt((x**2).mean()))


def rehearse(
    c: Configuration, runs: int, known: Knowledge, folder: Path, tell: Callable[[Step], None]
) -> Series:
    """Simulate up to `runs` runs, each with the feed-forward learned before it, and write their logs.

    The series ends early if the error no longer falls, if a run contradicts the condition of convergence,
    fails or is unusable, or at an interrupt after the first run.

    Raises ConfigurationError, LogError, PlantError, ModelError or OSError if the first run cannot be made or
    used.
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
            log, file = (folder / f"{c.name}-run-{number:02d}.{end}" for end in ("mcap", "csv"))
            made = simulate(_with(c, text, file, limit_N), log=log, check_replay=False)
            if not made["success"]:
                why = made["trouble"] or ", ".join(made["faults"])
                trouble = f"run {number}: {why}; --logs FOLDER keeps its log"
                break
            past = [*past[-1:], learning_run(log)]
            limit_N = limit_of(past[-1], known)
            outcome = learned(past, known)
            texts.append(text)
            steps.append(outcome.steps[-1])
            tell(steps[-1])
            if outcome.state != "learned":
                break
            text = outcome.text
    except (HilError, OSError, KeyboardInterrupt) as error:
        if not steps:
            raise
        interrupted = isinstance(error, KeyboardInterrupt)
        trouble = f"run {number}: {'interrupted' if interrupted else error}"
    best = min(range(len(steps)), key=lambda k: steps[k].rms_mm, default=0)
    return Series(steps, outcome, limit_N, texts[best] if texts else "", trouble, interrupted)


def _with(c: Configuration, text: str, path: Path, limit_N: float) -> Configuration:
    """The configuration with `text` as feed-forward file `path`; without feed-forward if `text` is empty."""
    section: dict[str, Any] | None = None
    if text:
        path.write_text(text, encoding="utf-8")
        section = {"file": str(path.absolute()), "limit_N": limit_N}
    return loads(with_changes(c.text, {"name": c.name, "feedforward": section}), c.source, c.folder)


def with_scale(c: Configuration, scale: float) -> Configuration:
    """The configuration with its law's masses scaled. Raises ConfigurationError: the law has no model."""
    believed = c.controller.believed
    if believed is None or "model" not in type(c.controller).model_fields:
        raise ConfigurationError(f"--inertia-scale: law {c.controller.law} has no model of the masses")
    change = {"controller": {"model": {"inertia_scale": scale * believed.inertia_scale}}, "name": c.name}
    return loads(with_changes(c.text, change), c.source, c.folder)
