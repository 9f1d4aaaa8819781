"""Where things are in a Rerun recording: the paths of its entities."""

from hil.record.selection import Component
from hil.study.view.panels import Curve

SCENE = "/robot"
"""The robot; its frame is the base frame."""
EVENTS = "/events"
DIFFERENCES = "/differences"
"""What is one column less another."""


def scalar_path(topic: str, part: Component) -> str:
    """Return the entity of a component: `/tick/tau/leg_3`."""
    return f"{topic}/{part.label.replace('.', '/')}"


def difference_path(curve: Curve) -> str:
    """Return the entity of a difference: `/differences/q_d-q/leg_3`."""
    assert curve.less is not None
    element = curve.part.label.removeprefix(curve.part.column.name).replace(".", "/")
    return f"{DIFFERENCES}/{curve.part.column.name}-{curve.less.column.name}{element}"


def curve_path(topic: str, curve: Curve) -> str:
    """Return the entity of a curve."""
    return difference_path(curve) if curve.less else scalar_path(topic, curve.part)
