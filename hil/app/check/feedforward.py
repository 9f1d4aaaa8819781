"""The part of `hil check` that says what is learned, and how much it can do where it is wrong."""

import numpy as np

from drivers.files import read_regular
from hil.app.check.findings import Report
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.feedforward_file import MOST_BYTES, feedforward_path, read_feedforward
from hil.app.unknown_payload import unknown_payload

STEEPEST = 1.875
"""Largest slope of the smooth step by which it fades, of its height over its length."""


def report_feedforward(report: Report, c: Configuration) -> None:
    """Say what the feed-forward was learned from, how large it is, and what it is to the certificate."""
    if c.feedforward is None:
        return
    path = feedforward_path(c.feedforward, c.folder)
    head, tau, start_s, step_s = read_feedforward(read_regular(path, MOST_BYTES), str(path))
    peak_N = float(np.abs(tau).max())
    pushed = float(np.abs(tau @ unknown_payload(c).mobility[0].T).max())
    end_s = start_s + step_s * (len(tau) - 1)
    period_s = 1.0 / c.loop.rate_Hz
    along_N = float(np.abs(np.diff(tau, axis=0)).max()) * period_s / step_s
    fading_N = peak_N * min(STEEPEST * period_s / c.feedforward.fade_s, 1.0)
    learned = f"{head.run} run(s), the last one {head.source} with {head.rms_error_mm:.3g} mm rms"
    within = f"limit {c.feedforward.limit_N:g}), {start_s:g} to {end_s:g} s of the reference"
    stated = f"monitor.disturbance_m_s2 {c.monitor.disturbance_m_s2:g}"
    report.sections["feed-forward"] = [
        f"learned from   {learned}; {head.first_rms_error_mm:.3g} mm without any",
        f"leg forces     up to {peak_N:.0f} N ({within}",
        f"changes        by up to {along_N:.3g} N a tick, {fading_N:.3g} N as it fades",
        f"where wrong    a disturbance of up to {pushed:.2g} m/s^2 in a leg, a part of {stated}",
    ]
    report.figures["feedforward"] = {
        "runs": head.run,
        "rms_error_mm": head.rms_error_mm,
        "peak_N": peak_N,
        "disturbance_m_s2": pushed,
        "step_N": along_N,
        "fade_step_N": fading_N,
    }
    if head.rate_Hz != c.loop.rate_Hz:
        report.warnings.append(
            f"the feed-forward was learned at {head.rate_Hz:g} Hz and loop.rate_Hz is {c.loop.rate_Hz:g}: "
            "delays are others, and what it knows of them is wrong: learn anew from a run at this rate"
        )
    worst_N, allowed_N = max(along_N, fading_N), c.limits.force_step_N
    if worst_N > allowed_N:
        mend = (
            "lengthen feedforward.fade_s"
            if fading_N > allowed_N
            else "lower feedforward.limit_N and learn again"
        )
        report.warnings.append(
            f"the learned feed-forward alone changes by up to {worst_N:.3g} N a tick, more than "
            f"limits.force_step_N {allowed_N:g}, which cuts it: {mend}, or allow more"
        )
    if pushed > c.monitor.disturbance_m_s2:
        report.warnings.append(
            f"where the learned feed-forward is wrong it pushes a leg by {pushed:.2g} m/s^2, more than "
            f"{stated}: the certificate may alarm. Lower "
            "feedforward.limit_N and learn again, or allow more"
        )
