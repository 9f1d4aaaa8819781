"""The part of `hil check` that says what is learned, and how much it can do where it is wrong."""

import numpy as np

from drivers.regular_file import read_regular
from hil.app.check.findings import Report
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.feedforward_file import MOST_BYTES, feedforward_path, read_feedforward
from hil.app.unknown_payload import unknown_payload


def report_feedforward(report: Report, c: Configuration) -> None:
    """Say what the feed-forward was learned from, how large it is, and what it is to the certificate."""
    if c.feedforward is None:
        return
    path = feedforward_path(c.feedforward, c.folder)
    head, tau, start_s, step_s = read_feedforward(read_regular(path, MOST_BYTES), str(path))
    peak_N = float(np.abs(tau).max())
    pushed = float(np.abs(tau @ unknown_payload(c).mobility[0].T).max())
    end_s = start_s + step_s * (len(tau) - 1)
    learned = f"{head.run} run(s), the last one {head.source} with {head.rms_error_mm:.3g} mm rms"
    within = f"limit {c.feedforward.limit_N:g}), {start_s:g} to {end_s:g} s of the reference"
    stated = f"monitor.disturbance_m_s2 {c.monitor.disturbance_m_s2:g}"
    report.sections["feed-forward"] = [
        f"learned from   {learned}; {head.first_rms_error_mm:.3g} mm without any",
        f"leg forces     up to {peak_N:.0f} N ({within}",
        f"where wrong    a disturbance of up to {pushed:.2g} m/s^2 in a leg, a part of {stated}",
    ]
    report.figures["feedforward"] = {
        "runs": head.run,
        "rms_error_mm": head.rms_error_mm,
        "peak_N": peak_N,
        "disturbance_m_s2": pushed,
    }
    if pushed > c.monitor.disturbance_m_s2:
        report.warnings.append(
            f"where the learned feed-forward is wrong it pushes a leg by {pushed:.2g} m/s^2, more than "
            f"{stated}: the certificate may alarm. Lower "
            "feedforward.limit_N and learn again, or allow more"
        )
