"""Report of `hil learn`: the runs, the filter, the unlearnable error with its cause, the next command."""

from collections.abc import Iterator
from math import hypot
from pathlib import Path
from typing import Any

from hil.config.model import ModelSettings
from hil.lab.learn.command import Outcome, Series, Step
from hil.lab.learn.convergence import FLAT
from hil.lab.learn.judgement import Floor

CAUSES = {
    "encoder_m": "steps of the encoders and of their frames",
    "rate_m": "noise of the leg rates, through the law",
    "not_repeating_m": "errors that differ from run to run or are not predicted",
    "beyond_filter_m": "errors at frequencies above the filter",
}


def table(steps: list[Step]) -> list[str]:
    """Text lines of the table of runs, errors in mm, forces in N."""
    lines = ["run   rms mm     peak mm    predicted mm  contraction  learned N"]
    for step in steps:
        ahead = "-" if step.predicted_mm is None else f"{step.predicted_mm:.5f}"
        factor = "-" if step.contraction is None else f"{step.contraction:.4f}"
        lines.append(
            f"{step.run.number:3d}   {step.rms_mm:<9.5f}  {step.peak_mm:<9.5f}  {ahead:<12}  {factor:<11}  "
            f"{step.learned_peak_N:.1f}"
        )
    return lines


def cause(floor: Floor) -> str:
    """Text that names the largest part of the error that cannot be learned."""
    parts = floor._asdict()
    return CAUSES[max(CAUSES, key=lambda name: float(parts[name]))]


def _floor_mm(floor: Floor) -> dict[str, float]:
    return {key.removesuffix("_m"): 1e3 * value for key, value in floor._asdict().items()}


def lines(made: Series, out: Path | None, believed: ModelSettings | None = None) -> Iterator[str]:
    """Text lines about a learning series; out: path of the written file; believed: scaled model, if any."""
    if made.outcome is not None:
        yield from table(made.steps)
        yield from _judged(made.outcome, made.limit_N)
        first, last = made.steps[0], made.steps[-1]
        if last is not first and last.rms_mm > 0.0 and last.peak_mm > 0.0:
            yield (
                f"From run {first.run.number} to run {last.run.number}: rms {first.rms_mm / last.rms_mm:.3g}"
                f"-fold, peak {first.peak_mm / last.peak_mm:.3g}-fold smaller"
            )
    if made.trouble:
        yield f"Stopped    {made.trouble}"
    if made.best and out is not None:
        yield f"written    {out}"
        yield f"feedforward: {{file: {out.name}, limit_N: {made.limit_N:.15g}}}"
        if believed is not None:
            yield (
                "           The file was made for a law with controller.model.inertia_scale: "
                f"{believed.inertia_scale!r} (--inertia-scale): set that key, too"
            )
    elif made.outcome is not None and out is not None:
        yield f"{out} is not written"


def _judged(outcome: Outcome, limit_N: float) -> Iterator[str]:
    floor, choice, last = outcome.floor, outcome.learner.choice, outcome.steps[-1]
    end_Hz = choice.Q.end_Hz
    parts = ", ".join(f"{name.replace('_', ' ')} {mm:.2g}" for name, mm in _floor_mm(floor).items())
    band = f"1 up to {FLAT * end_Hz:.3g} Hz, 0 from {end_Hz:.3g} Hz on"
    least = f"|Q (1 - L P)| <= {choice.contraction:.2f} (largest at {choice.at_Hz:.3g} Hz)"
    yield f"Filter     zero phase, {band}: the widest with {least}"
    yield f"Plants     {outcome.learner.belief.source}"
    yield f"Floor      {1e3 * hypot(*floor):.2g} mm rms, largest part {cause(floor)}: {parts}"
    if last.contradicted is not None:
        c = last.contradicted
        what = f"the error went to {100 * c.factor:.3g} % of its value in the run before"
        allowed = f"allowed by the stated uncertainty: {100 * c.allowed:.3g} %"
        yield f"Refused    leg {c.axis} at {c.f_Hz:.3g} Hz: {what}, {allowed}"
        yield "           More learning would increase the error: keep the feed-forward of the run before,"
        yield "           or identify the axes (hil identify), and learn with --axes"
        return
    if outcome.state == "floor":
        left = f"Learned out: {last.in_band_mm:.2g} mm are left within the filter, and no run reduces them"
        yield f"{left}; the feed-forward of the last run stays the best"
    else:
        yield f"Next run   {outcome.predicted_mm:.2g} mm rms predicted by the nominal axes"
    if outcome.cut:
        yield (
            f"Cut        at {outcome.cut} instants a leg needs more than {limit_N:g} N: the error "
            "does not fall there; allow more with --limit or feedforward.limit_N"
        )


def summary(made: Series, out: Path | None) -> dict[str, Any]:
    """A learning series as plain values for the JSON summary."""
    outcome = made.outcome
    if outcome is None:
        return {"success": False, "kind": "learn", "state": "failed", "trouble": made.trouble, "runs": []}
    choice, found = outcome.learner.choice, outcome.steps[-1].contradicted
    ended = "interrupted" if made.interrupted else "failed" if made.trouble else outcome.state
    return {
        "success": outcome.state != "contradicted" and not made.trouble,
        "kind": "learn",
        "state": ended,
        "trouble": made.trouble or None,
        "runs": [{"log": str(step.run.path), "run": step.run.number} | _figures(step) for step in made.steps],
        "filter_end_Hz": choice.Q.end_Hz,
        "contraction_bound": choice.contraction,
        "contraction_bound_at_Hz": choice.at_Hz,
        "plants": outcome.learner.belief.source,
        "floor_mm": _floor_mm(outcome.floor),
        "floor_cause": cause(outcome.floor),
        "contradiction": None if found is None else found._asdict(),
        "cut_instants": outcome.cut,
        "predicted_next_mm": outcome.predicted_mm,
        "written": str(out) if made.best and out is not None else None,
    }


def _figures(step: Step) -> dict[str, float | None]:
    return {key: value for key, value in step._asdict().items() if key not in {"run", "contradicted"}}
