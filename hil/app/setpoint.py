"""`hil setpoint`: send a live reference somewhere, through the operator channel of a running controller."""

from collections.abc import Iterable
from typing import Any

from drivers.bus_address import BusAddress
from drivers.errors import RunError
from hil.operate.client import OperatorClient


def send_setpoints(bus: BusAddress, lines: Iterable[str]) -> dict[str, Any]:
    """Send each line `x y z [rx ry rz]` (m, deg) as it comes; return the summary.

    A controller that ends meanwhile is trouble of the summary, which says how many it had taken. Raises
    RunError when no controller listens, or none answers the first line.
    """
    sent, taken, refused, trouble = 0, 0, list[str](), ""
    with OperatorClient(*bus) as client:
        for line in lines:
            if not line.strip():
                continue
            sent += 1
            try:
                answer = client.say(f"setpoint {line.strip()}")
            except RunError as error:
                if sent == 1:
                    raise
                trouble = f"{line.strip()}: {error}"
                break
            taken += bool(answer)
            if not answer:
                refused.append(f"{line.strip()}: {answer.why}")
    summary = {
        "success": sent > 0 and not refused and not trouble,
        "kind": "setpoint",
        "sent": sent,
        "taken": taken,
        "refused": refused,
    }
    return summary | ({"trouble": trouble} if trouble else {})
