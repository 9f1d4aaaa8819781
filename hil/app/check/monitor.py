"""The part of `hil check` that says whether the loop's certificate is watched."""

from hil.app.check.findings import Report
from hil.app.configuration.configuration import Configuration
from hil.stability.monitor import certified


def report_monitor(report: Report, c: Configuration) -> None:
    """Say whether the law has a certificate, and what breaks it."""
    dynamics, action = certified(c.controller), c.monitor.action
    report.figures["monitor"] = {"watched": not isinstance(dynamics, str), "action": action}
    if isinstance(dynamics, str):
        report.sections["controller"].append(f"not monitored: {dynamics}")
        return
    what = {"log": "shows in the log alone", "warn": "warns", "fault": "faults"}[action]
    unit = f"{c.monitor.disturbance_m_s2:g} m/s^2"
    if dynamics.pose:
        unit += f" or {c.monitor.disturbance_rad_s2:g} rad/s^2"
    report.sections["controller"].append(
        f"monitored: growth of the error beyond what a disturbance of {unit} explains {what}"
    )
