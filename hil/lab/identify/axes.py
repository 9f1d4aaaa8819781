"""`hil identify`: frequency responses of the linearised axes, from a test run or a log with excitation."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Rows
from drivers.errors import HilError
from drivers.files import whole_file
from drivers.signals import Mode
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.section_file import check_section_path, write_section
from hil.app.files import printable
from hil.app.output import further, picture_beside
from hil.app.recorded_files import attached
from hil.config.axis_model import AxisModel, AxisResponse, AxisSpace, NominalAxis, UncertaintyProfile
from hil.config.reference import MultisineReference, SinusoidReference
from hil.lab.identify.delay import compensation, compensation_lines, delay_figures, delay_rows
from hil.lab.identify.estimators.axis_fit import (
    COHERENT,
    Fit,
    Uncertainty,
    axis_response,
    fit_axes,
    uncertainty,
)
from hil.lab.identify.estimators.excitation import axis_excitation
from hil.lab.identify.estimators.response import Response, estimate, periodic, segmented
from hil.lab.identify.linearised import linearised_law, repeating, settled, signals_of
from hil.lab.identify.runs import (
    exact_model,
    excitation_force,
    excitation_pose,
    excited_by,
    recorded_run,
    refuse_fused,
)

REMARK = "Made by hil identify: the linearised axes from demanded acceleration to measured position."


class Identified(NamedTuple):
    """Linearised axes identified from a log, with the fit and the bound of the model error."""

    model: AxisModel
    fit: Fit
    uncertainty: Uncertainty
    blocks: int
    repeats: bool
    motion_mm: float


def excited_axes(
    c: Configuration, force_N: float | None, duration_s: float | None
) -> tuple[Configuration, float]:
    """Configuration that moves each axis of its law by a multisine, and the largest force used, N.

    Raises ConfigurationError: a fused pose, a law that does not linearise, a force that the limits would cut,
    or a pose out of reach; IdentificationError: too short a duration.
    """
    refuse_fused(c, c.source)
    space = linearised_law(c).space
    force = excitation_force(c, force_N)
    made = axis_excitation(exact_model(c), excitation_pose(c), space, c.loop.rate_Hz, force, duration_s)
    return excited_by(c, made), force


def outputs(log: Path, model: Path | None) -> tuple[Path, Path]:
    """Paths of the model file (by default next to the log) and of its picture.

    Raises ConfigurationError or LogError if they cannot be written.
    """
    path = model or log.with_name(f"{log.stem}-axes.yaml")
    check_section_path("--model", path, AxisModel)
    return path, picture_beside(path, "--model")


def axes_of_log(path: Path) -> Identified:
    """Axes identified from a log of `hil run` or `hil sim`.

    Raises LogError for another kind of file or a log without tracking, ConfigurationError for a fused pose or
    a law that does not linearise, IdentificationError for too little data.
    """
    recorded = recorded_run(path)
    refuse_fused(recorded.configuration, path)
    try:
        with attached(recorded.configuration, recorded.attachments) as c:
            return _identified(path, c, recorded.rows, recorded.rate_Hz)
    except HilError as error:
        raise type(error)(f"{path}: {error}") from None


def _identified(path: Path, c: Configuration, rows: Rows, rate_Hz: float) -> Identified:
    law = linearised_law(c)
    signals, t = signals_of(rows, law, rate_Hz)
    lines = repeating(c.reference, rate_Hz)
    if lines is not None:
        assert isinstance(c.reference, SinusoidReference | MultisineReference)
        good = settled(signals, t, c.reference, lines[0])
        spectra = periodic(signals._replace(good=good), *lines)
    else:
        spectra = segmented(signals)
    response = estimate(spectra)
    fit = fit_axes(response)
    bound = uncertainty(response, fit)
    model = AxisModel(
        kind="axis-model",
        source=str(path),
        axes=law.space,
        rate_Hz=rate_Hz,
        nominal=NominalAxis(
            gain=_rounded(fit.gain),
            transport_ms=_rounded([1e3 * fit.delays.transport_s])[0],
            lag_ms=_rounded([1e3 * fit.delays.lag_s])[0],
        ),
        uncertainty=UncertaintyProfile(
            frequency_Hz=_rounded(bound.frequency_Hz), bound=_rounded(bound.bound)
        ),
        measured=[_measured(response, axis) for axis in range(6)],
    )
    motion = 1e3 * float(np.ptp(rows["q"][rows["mode"] == Mode.TRACKING], axis=0).min())
    return Identified(model, fit, bound, len(spectra.V), lines is not None, motion)


def _measured(response: Response, axis: int) -> AxisResponse:
    lines = np.flatnonzero(response.excited[:, axis] & np.isfinite(response.G[:, axis]))
    G, std = response.G[lines, axis], response.std[lines, axis]
    return AxisResponse(
        frequency_Hz=_rounded(response.frequency_Hz[lines]),
        magnitude=_rounded(np.abs(G)),
        # -360 .. 0: a double integrator and its delay are around -180
        phase_deg=_rounded(np.rad2deg(np.angle(-G) - np.pi)),
        coherence=_rounded(response.coherence[lines, axis]),
        magnitude_std=_rounded(std * np.abs(G)),
        phase_std_deg=_rounded(np.rad2deg(std)),
    )


def _rounded(values: Iterable[float]) -> list[float]:
    return [float(f"{value:.6g}") for value in values]


def save(identified: Identified, files: tuple[Path, Path], title: str) -> dict[str, Any]:
    """Write the identified model and its picture; return their paths and the errors of writing."""
    written: dict[str, Any] = {"model": None, "picture": None}
    model, picture = files
    with further(written):
        write_section(model, identified.model, REMARK)
        written["model"] = str(model)
    with further(written):
        draw(identified.model, picture, title)
        written["picture"] = str(picture)
    return written


def summary(identified: Identified, path: Path, written: Mapping[str, Any]) -> dict[str, Any]:
    """Identified axes as plain values for the JSON summary; written: the return value of `save`."""
    fit, model = identified.fit, identified.model
    return {
        "success": True,
        "kind": "identify",
        "log": str(path),
        **written,
        "axes": model.axes,
        **delay_figures(fit.delays, 0.5 / model.rate_Hz),
        "delay_compensation": compensation(fit.delays, 0.5 / model.rate_Hz),
        "gain": fit.gain.tolist(),
        "gain_std": fit.gain_std.tolist(),
        "coherent_lines": fit.used.sum(axis=0).tolist(),
        "blocks": identified.blocks,
        "repeats": identified.repeats,
        "coupled": identified.uncertainty.coupled,
        "motion_mm": identified.motion_mm,
        "bound": dict(zip(map(str, model.uncertainty.frequency_Hz), model.uncertainty.bound, strict=True)),
    }


def report(result: dict[str, Any], model: AxisModel) -> list[str]:
    """Lines of text about identified axes: gains, delay, bound of the model error, and files."""
    profile = model.uncertainty
    f, bound = np.array(profile.frequency_Hz), np.array(profile.bound)
    marks = [x for x in (1.0, 3.0, 10.0, 30.0, 100.0, 300.0) if f[0] <= x <= f[-1]]
    bounds = ", ".join(f"{100 * np.interp(np.log(x), np.log(f), bound):.2g} % at {x:g} Hz" for x in marks)
    kind = "whole periods" if result["repeats"] else "half-overlapping segments"
    fewest, least = min(zip(result["coherent_lines"], NAMES[model.axes], strict=True))
    gains = zip(NAMES[model.axes], result["gain"], result["gain_std"], strict=True)
    of_gain = ", ".join(f"{name} {g:.4f} +- {2 * s:.4f}" for name, g, s in gains)
    coupling = ", coupling included" if result["coupled"] else ""
    blocks = f"{result['blocks']} {kind}, {f[0]:g} to {f[-1]:g} Hz"
    lines = [
        f"From demanded acceleration to measured position, {model.axes} axes (+- two standard deviations):",
        f"  gain         {of_gain}; 1 where model and robot agree",
        *delay_rows(result, "slope of the phase"),
        f"Bound of |P/P0 - 1|, 95 %: {bounds}{coupling}",
        f"{blocks}; {fewest} coherent lines at least ({least}); {result['motion_mm']:.2g} mm of each leg",
    ]
    if not result["coupled"]:
        lines.append(
            "At some frequencies the axes moved together: the bound does not cover their coupling there. "
            "`hil identify CONFIG` moves each axis by itself; a larger --force exceeds friction."
        )
    lines += [f"{key:<7}  {result[key]}" for key in ("model", "picture") if result[key]]
    return [*lines, *compensation_lines(result["delay_compensation"])]


NAMES: dict[AxisSpace, tuple[str, ...]] = {
    "joint": tuple(f"leg {k}" for k in range(6)),
    "pose": ("x", "y", "z", "rx", "ry", "rz"),
}


def draw(model: AxisModel, path: Path, title: str) -> Path:
    """Draw the measured frequency responses with two standard deviations, fitted axes, coherence and bound.

    Magnitude and phase are those of P s^2 / gain, from demanded to actual acceleration, since 1/s^2 itself
    would hide delay and lag. Raises OSError if the file cannot be written.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415 - half a second

    figure = Figure(figsize=(12, 8.5), layout="constrained")
    (magnitude, coherence), (phase, bound) = figure.subplots(2, 2, sharex=True)
    T = 1.0 / model.rate_Hz
    transport, lag = 1e-3 * model.nominal.transport_ms, 1e-3 * model.nominal.lag_ms
    for k, (name, gain, axis) in enumerate(
        zip(NAMES[model.axes], model.nominal.gain, model.measured, strict=True)
    ):
        f = np.array(axis.frequency_Hz)
        w2 = (2.0 * np.pi * f) ** 2 / gain
        G = np.array(axis.magnitude) * np.exp(1j * np.deg2rad(axis.phase_deg))
        style = {"fmt": "o", "markersize": 3, "linewidth": 0.8, "color": f"C{k}"}
        magnitude.errorbar(f, np.abs(G) * w2, 2.0 * np.array(axis.magnitude_std) * w2, label=name, **style)
        phase.errorbar(f, np.rad2deg(np.angle(-G)), 2.0 * np.array(axis.phase_std_deg), **style)
        coherence.plot(f, axis.coherence, "o-", markersize=3, linewidth=0.5, color=f"C{k}")
        P0 = gain * axis_response(f, T, transport, lag)
        bound.plot(f, 100.0 * np.abs(G / P0 - 1.0), "o", markersize=3, color=f"C{k}")
    ends = model.uncertainty.frequency_Hz
    f = np.geomspace(ends[0], ends[-1], 400)
    P0 = axis_response(f, T, transport, lag)
    magnitude.plot(f, np.abs(P0) * (2.0 * np.pi * f) ** 2, "k-", linewidth=1.0, label="nominal")
    phase.plot(f, np.rad2deg(np.unwrap(np.angle(-P0))), "k-", linewidth=1.0)
    coherence.axhline(COHERENT, color="k", linestyle="--", linewidth=0.8)
    coherence.set(title="coherence; below the dashed line for the bound alone", ylim=(0.0, 1.02))
    bound.plot(ends, 100.0 * np.array(model.uncertainty.bound), "k-", label="bound, with 95 % confidence")
    bound.set(title="|P/P0 - 1|", ylabel="%", xlabel="Hz", yscale="log")
    bound.legend(loc="upper left")
    magnitude.set(title="|P| (2 pi f)^2 / gain", xscale="log")
    magnitude.legend(loc="lower left", ncols=2)
    total = transport + lag + 0.5 * T
    phase.set(title=f"phase of -P; its slope is {1e3 * total:.3f} ms", ylabel="deg", xlabel="Hz")
    for axes in (magnitude, phase, coherence, bound):
        axes.grid(alpha=0.3, which="both")
    figure.suptitle(printable(title), parse_math=False)
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=100)
    return path
