"""`hil setpoint`: send a live reference somewhere, through the operator channel of a running controller."""

from collections.abc import Iterable
from typing import Any

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import Configuration
from hil.config.reference import LiveReference
from hil.operate.client import OperatorClient


def require_live(c: Configuration) -> None:
    """Raise ConfigurationError for a reference that takes no set-points."""
    if not isinstance(c.reference, LiveReference):
        raise ConfigurationError(
            f"{c.source}: reference.type: {c.reference.type} takes no set-points, allowed: live"
        )


def send_setpoints(configuration: Configuration, lines: Iterable[str]) -> dict[str, Any]:
    """Send each line `x y z [rx ry rz]` (m, deg) as it comes; return the summary.

    Raises ConfigurationError when the reference takes no set-points, RunError when no controller listens or
    answers.
    """
    c = configuration
    require_live(c)
    sent, refused = 0, []
    with OperatorClient(c.bus.interface, c.bus.channel) as client:
        for line in lines:
            if not line.strip():
                continue
            sent += 1
            answer = client.say(f"setpoint {line.strip()}")
            if not answer:
                refused.append(f"{line.strip()}: {answer.why}")
    return {
        "success": sent > 0 and not refused,
        "kind": "setpoint",
        "sent": sent,
        "taken": sent - len(refused),
        "refused": refused,
    }
