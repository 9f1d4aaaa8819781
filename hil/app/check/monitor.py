"""The part of `hil check` that says whether the loop's certificate is watched."""

from hil.app.check.findings import Report
from hil.app.configuration.configuration import Configuration
from hil.app.unknown_payload import unknown_payload
from hil.design.stability.monitor import certified


def report_monitor(report: Report, c: Configuration) -> None:
    """Say whether the law has a certificate, and what breaks it."""
    dynamics, action = certified(c.controller), c.monitor.action
    report.figures["monitor"] = {"watched": not isinstance(dynamics, str), "action": action}
    if isinstance(dynamics, str):
        report.sections["controller"].append(f"not monitored: {dynamics}")
        return
    what = {"log": "shows in the log alone", "warn": "warns", "fault": "faults"}[action]
    payload = unknown_payload(c)
    allowed = (payload.allowed_of_the_pose if dynamics.pose else payload.allowed)(c.monitor)
    unit = f"{allowed.disturbance_m_s2:.3g} m/s^2"
    if dynamics.pose:
        unit += f" or {allowed.disturbance_rad_s2:.3g} rad/s^2"
    report.sections["controller"].append(
        f"monitored: growth of the error beyond what a disturbance of {unit} explains {what}"
    )
