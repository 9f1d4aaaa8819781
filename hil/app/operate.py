"""`hil ctl` and `hil setpoint`: sends an operator's commands from a terminal to a running controller."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from drivers.bus_address import BusAddress
from drivers.errors import RunError

if TYPE_CHECKING:
    from hil.operate.client import OperatorClient

REPEAT_S = 0.02
"""Period of key frames and of repeated jog commands."""
REPEATED = frozenset({"key", "jog"})
"""Commands that act only while they are repeated."""
SHOWN = {
    "mode": "mode",
    "faults": "faults",
    "waits_for": "waits for",
    "key": "key",
    "speed_percent": "requested speed, %",
    "speed_now_percent": "speed now, %",
    "path_s": "along the path, s",
    "path_length_s": "of, s",
    "position_m": "position, m",
    "rotation_vector_deg": "rotation vector, deg",
    "leg_lengths_m": "leg lengths, m",
    "tick": "tick",
    "refused_lines": "invalid lines",
}


def status(bus: BusAddress) -> dict[str, Any]:
    """Status of the running controller as a summary. Raises RunError: no controller runs or answers."""
    with _client(bus) as client:
        return {"success": True, "kind": "ctl", **client.status()}


def status_lines(summary: dict[str, Any]) -> list[str]:
    """Status of the running controller as lines for the terminal."""
    return [f"{title:26s}{_shown(summary[key])}" for key, title in SHOWN.items()]


def _shown(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, list):
        return "  ".join(each if isinstance(each, str) else f"{each:.4f}" for each in value) or "none"
    return f"{value:.4g}" if isinstance(value, float) else str(value) or "nothing"


def _client(bus: BusAddress) -> OperatorClient:
    from hil.operate import client

    return client.OperatorClient(*bus)


def say(bus: BusAddress, words: Sequence[str], seconds: float | None = None) -> dict[str, Any]:
    """Send one command; hold the key, or repeat a jog, until Ctrl-C or for `seconds`; return the summary.

    Its `trouble` reports a refused command, or a controller that ended during a repeated one. Raises
    RunError: no controller runs or answers.
    """
    line, sent, begun, trouble = " ".join(words), 0, time.monotonic(), ""
    repeated = line == "key" or words[0] == "jog"
    with _client(bus) as client:
        try:
            with contextlib.suppress(*[KeyboardInterrupt] * repeated):  # Ctrl-C releases a key or a jog
                while not sent or (repeated and (seconds is None or time.monotonic() - begun < seconds)):
                    if line == "key":
                        client.key()
                    elif not (answer := client.say(line)):
                        trouble = f"refused: {answer.why}"
                        break
                    sent += 1
                    time.sleep(REPEAT_S * repeated)
            if words[0] == "jog" and not trouble:
                client.say(f"jog {words[1]} 0")
        except RunError as error:
            if not sent:
                raise
            trouble = str(error)
    result = {"success": not trouble, "kind": "ctl", "command": line}
    return result | ({"sent": sent} if repeated else {}) | ({"trouble": trouble} if trouble else {})


def send_setpoints(bus: BusAddress, lines: Iterable[str]) -> dict[str, Any]:
    """Send each line `x y z [rx ry rz]` (m, deg) as a set-point as it arrives; return the summary.

    A controller that ends meanwhile is the `trouble` of the summary, which counts the accepted set-points.
    Raises RunError: no controller listens, or none answers the first line.
    """
    sent, taken, refused, trouble = 0, 0, list[str](), ""
    with _client(bus) as client:
        for line in filter(None, map(str.strip, lines)):
            sent += 1
            try:
                answer = client.say(f"setpoint {line}")
            except RunError as error:
                if sent == 1:
                    raise
                trouble = f"{line}: {error}"
                break
            taken += bool(answer)
            if not answer:
                refused.append(f"{line}: {answer.why}")
    good = sent > 0 and not refused and not trouble
    summary = {"success": good, "kind": "setpoint", "sent": sent, "taken": taken, "refused": refused}
    return summary | ({"trouble": trouble} if trouble else {})
