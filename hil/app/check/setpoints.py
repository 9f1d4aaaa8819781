"""What `hil check` says of set-points: what the legs may have to do near the start."""

import numpy as np

from hil.app.check.findings import Report
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform
from hil.config.reference import LiveReference
from hil.mathematics.rotations import rotation_from_vector
from hil.robot.kinematics import jacobian
from hil.trajectory.path import axis_limits, six_words


def setpoint_peaks(c: Configuration, reference: LiveReference) -> tuple[float, float]:
    """Return rate, m/s, and acceleration, m/s^2, of a leg near the start, all axes at their limits."""
    chi = six_words(reference.start or c.platform.home)
    legs = np.abs(jacobian(build_platform(c.platform), chi[:3], rotation_from_vector(chi[3:])))
    fastest, hardest = (float((legs @ words).max()) for words in axis_limits(reference.limits)[:2])
    return fastest, hardest


def report_setpoints(report: Report, c: Configuration, reference: LiveReference) -> None:
    """Say what the legs may have to do where all axes move at their limits at once, near the start."""
    fastest, hardest = setpoint_peaks(c, reference)
    report.figures["reference"]["setpoint_rate_max_m_s"] = fastest
    report.figures["reference"]["setpoint_acceleration_max_m_s2"] = hardest
    if hardest > c.limits.deceleration_m_s2:
        report.warnings.append(
            f"set-points may brake a leg by {hardest:.2f} m/s^2 near the start, limits.deceleration_m_s2 is "
            f"{c.limits.deceleration_m_s2:g}: before a soft end that is a fault; lower the accelerations of "
            "reference.limits"
        )
    if fastest > c.limits.speed_m_s:
        report.warnings.append(
            f"set-points on all axes at once may ask for {fastest:.2f} m/s in a leg near the start, "
            f"limits.speed_m_s is {c.limits.speed_m_s:g}: lower the velocities of reference.limits"
        )
