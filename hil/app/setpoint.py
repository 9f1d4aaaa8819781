"""`hil setpoint`: send a live reference somewhere, through the operator channel of a running controller."""

from collections.abc import Iterable
from typing import Any

from drivers.bus_address import BusAddress
from hil.operate.client import OperatorClient


def send_setpoints(bus: BusAddress, lines: Iterable[str]) -> dict[str, Any]:
    """Send each line `x y z [rx ry rz]` (m, deg) as it comes; return the summary.

    Raises RunError when no controller listens or answers.
    """
    sent, refused = 0, []
    with OperatorClient(*bus) as client:
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
