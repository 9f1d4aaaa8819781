"""Rules on the estimate: lengths that fit no pose, another assembly, a near singularity.

Each rule is written so that a value that is not a number faults.
"""

from drivers.compiled.compiler import helper

HOP = 1.0
"""Measure of a hop from which a pose cannot be told from another assembly's; see `hil.estimation.pose`."""


@helper
def inconsistent(residual: float, limit: float) -> bool:
    """Tell whether the largest leg residual of forward kinematics (m) is above its limit."""
    return not residual <= limit


@helper
def hopped(hop: float) -> bool:
    """Tell whether the pose may belong to another assembly."""
    return not hop < HOP


@helper
def ill_conditioned(condition: float, limit: float) -> bool:
    """Tell whether the condition number of J is above its limit."""
    return not condition <= limit
