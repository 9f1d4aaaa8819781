"""What `hil learn` says: the runs, the filter, the floor with its cause, and what to do next."""

from pathlib import Path
from typing import Any

from hil.config.model import ModelSettings
from hil.lab.learn.command import Outcome, Step
from hil.lab.learn.convergence import FLAT
from hil.lab.learn.judgement import Floor
from hil.lab.learn.rehearsal import Rehearsal

CAUSES = {
    "encoder_m": "steps of the encoders and of their frames",
    "rate_m": "noise of the leg rates, through the law",
    "not_repeating_m": "what does not repeat from run to run, or is not predicted",
    "beyond_filter_m": "what is faster than the filter",
}


def table(steps: list[Step]) -> list[str]:
    """Return the runs as lines."""
    lines = ["run   rms mm     peak mm    predicted mm  contraction  learned N"]
    for step in steps:
        ahead = "-" if step.predicted_mm is None else f"{step.predicted_mm:.5f}"
        factor = "-" if step.contraction is None else f"{step.contraction:.4f}"
        lines.append(
            f"{step.run.number:3d}   {step.rms_mm:<9.5f}  {step.peak_mm:<9.5f}  {ahead:<12}  {factor:<11}  "
            f"{step.peak_N:.1f}"
        )
    return lines


def cause(floor: Floor) -> str:
    """Return the largest part of a floor."""
    name = max(CAUSES, key=lambda name: float(getattr(floor, name)))
    return CAUSES[name]


def _share(floor: Floor) -> str:
    """Return how much of a floor its largest part is; the parts add up by their squares."""
    return "most of it" if 2.0 * max(floor) ** 2 > floor.total_m**2 else "the largest part of it"


def lines(outcome: Outcome, limit_N: float, out: Path | None, *, series: bool = False) -> list[str]:
    """Return what the user reads; series: what is written is said behind it."""
    model, floor, choice = outcome.learner, outcome.floor, outcome.learner.choice
    end_Hz = choice.Q.end_Hz
    filter_line = (
        f"Filter     zero phase, 1 up to {FLAT * end_Hz:.3g} Hz, 0 from {end_Hz:.3g} Hz on: the widest with "
        f"|Q (1 - L P)| <= {choice.contraction:.2f} (largest at {choice.at_Hz:.3g} Hz)"
    )
    parts = (f"{_words(name)} {1e3 * value:.2g}" for name, value in floor._asdict().items())
    largest = f"{_share(floor)} {cause(floor)}"
    floor_line = f"Floor      {1e3 * floor.total_m:.2g} mm rms, {largest}: {', '.join(parts)}"
    found = [*table(outcome.steps), filter_line, f"Plants     {model.belief.source}", floor_line]
    last = outcome.steps[-1]
    if outcome.state == "contradicted":
        return found + contradicted(last, series=series)
    if outcome.state == "floor":
        left = f"Learned out: {last.in_band_mm:.2g} mm are left within the filter, and no run takes more off"
        stays = "the feed-forward that ran stays the best one, none is written"
        found.append(left if series else f"{left}; {stays if last.run.number else 'nothing is written'}")
    else:
        found.append(f"Next run   {outcome.predicted_mm:.2g} mm rms predicted by the nominal axes")
    if outcome.cut:
        found.append(
            f"Cut        at {outcome.cut} instants a leg asks for more than {limit_N:g} N: the error "
            "does not fall there; allow more with --limit or feedforward.limit_N"
        )
    if out is not None and outcome.state == "learned":
        found += written(out, limit_N)
    return found


def written(out: Path, limit_N: float, what: str = "") -> list[str]:
    """Return that a file is written, and the section that names it."""
    return [f"written    {out}{what}", f"feedforward: {{file: {out.name}, limit_N: {limit_N:.15g}}}"]


def _words(name: str) -> str:
    return name.removesuffix("_m").replace("_", " ")


def contradicted(step: Step, *, series: bool) -> list[str]:
    """Return why learning has to end."""
    found = step.contradicted
    assert found is not None
    what = (
        f"Refused    leg {found.axis} at {found.f_Hz:.3g} Hz: the error went to {100 * found.factor:.3g} % "
        f"of what it was in the run before, allowed by the stated uncertainty: {100 * found.allowed:.3g} %"
    )
    back = "" if series else "Nothing is written: go back to the feed-forward of the run before, "
    hint = (
        "           The plant is beyond it, and learning on would let the error grow. "
        f"{back or 'To go on, '}identify the axes (hil identify), learn with --axes"
    )
    return [what, hint]


def summary(outcome: Outcome, out: Path | None) -> dict[str, Any]:
    """Return the outcome as plain values."""
    model, choice = outcome.learner, outcome.learner.choice
    found = outcome.steps[-1].contradicted
    return {
        "success": outcome.state != "contradicted",
        "kind": "learn",
        "state": outcome.state,
        "runs": [
            {
                "log": str(step.run.path),
                "run": step.run.number,
                "rms_mm": step.rms_mm,
                "peak_mm": step.peak_mm,
                "in_band_mm": step.in_band_mm,
                "predicted_mm": step.predicted_mm,
                "contraction": step.contraction,
                "learned_peak_N": step.peak_N,
            }
            for step in outcome.steps
        ],
        "filter_end_Hz": choice.Q.end_Hz,
        "contraction_bound": choice.contraction,
        "contraction_bound_at_Hz": choice.at_Hz,
        "plants": model.belief.source,
        "floor_mm": {key.removesuffix("_m"): 1e3 * value for key, value in outcome.floor._asdict().items()},
        "floor_cause": cause(outcome.floor),
        "contradiction": None if found is None else found._asdict(),
        "cut_instants": outcome.cut,
        "predicted_next_mm": outcome.predicted_mm,
        "written": str(out) if out is not None and outcome.state == "learned" else None,
    }


def series(made: Rehearsal, out: Path | None, believed: ModelSettings | None = None) -> list[str]:
    """Return what the user reads of a series of runs; believed: those of --inertia-scale."""
    if made.outcome is None:
        return [f"Stopped    {made.trouble}"]
    found = lines(made.outcome._replace(steps=made.steps), made.limit_N, None, series=True)
    first, last = made.steps[0], made.steps[-1]
    if last is not first and last.rms_mm > 0.0 and last.peak_mm > 0.0:
        found.append(
            f"From run {first.run.number} to run {last.run.number}: "
            f"rms {first.rms_mm / last.rms_mm:.3g}-fold, "
            f"peak {first.peak_mm / last.peak_mm:.3g}-fold smaller"
        )
    if made.trouble:
        found.append(f"Stopped    {made.trouble}")
    if made.best and out is not None:
        found += written(out, made.limit_N, ", of the run with the smallest error")
        if believed is not None:
            found.append(
                "           The file belongs to a law with controller.model.inertia_scale: "
                f"{believed.inertia_scale!r} (from --inertia-scale), and is refused with another: set that "
                "key, too, or learn without --inertia-scale"
            )
    elif out is not None:
        none = "the only run" if last is first else "the run with the smallest error"
        found.append(f"{out} is not written: {none} was the one without a feed-forward")
    return found


def series_summary(made: Rehearsal, out: Path | None) -> dict[str, Any]:
    """Return a series of runs as plain values."""
    written = str(out) if made.best and out is not None else None
    if made.outcome is None:
        return {"success": False, "kind": "learn", "state": "failed", "trouble": made.trouble, "runs": []}
    found = summary(made.outcome._replace(steps=made.steps), None)
    state = "interrupted" if made.interrupted else "failed" if made.trouble else found["state"]
    return found | {
        "success": found["success"] and not made.trouble,
        "state": state,
        "trouble": made.trouble or None,
        "written": written,
    }
