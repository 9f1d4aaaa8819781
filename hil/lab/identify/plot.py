"""An axis model as a picture: magnitude, phase, coherence and bound over frequency."""

from pathlib import Path

import numpy as np

from drivers.files import whole_file
from hil.app.files import printable
from hil.config.axis_model import AxisModel, AxisSpace
from hil.lab.identify.estimators.axis_fit import COHERENT
from hil.lab.identify.estimators.nominal import axis_response

NAMES: dict[AxisSpace, tuple[str, ...]] = {
    "joint": tuple(f"leg {k}" for k in range(6)),
    "pose": ("x", "y", "z", "rx", "ry", "rz"),
}


def draw(model: AxisModel, path: Path, title: str) -> Path:
    """Draw measured points with two standard deviations, the nominal axis, coherence and bound.

    Magnitude and phase are those of P s^2 / gain, from demanded to acting acceleration: on 1/s^2 itself
    neither delay nor lag could be seen. Raises OSError where the file cannot be written.
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
