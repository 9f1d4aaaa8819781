"""`hil ctl`: the operator's commands to a running controller, from a terminal."""

import contextlib
import time
from collections.abc import Sequence
from typing import Any

from drivers.bus_address import BusAddress
from drivers.errors import RunError
from hil.operate.client import OperatorClient

REPEAT_S = 0.02
"""Between two key frames, or words of a jog."""
REPEATED = frozenset({"key", "jog"})
"""Words that count for as long as they are said again."""
SHOWN = {
    "mode": "mode",
    "faults": "faults",
    "waits_for": "waits for",
    "key": "key",
    "speed_percent": "speed asked for, %",
    "speed_now_percent": "speed now, %",
    "path_s": "along the path, s",
    "path_length_s": "of, s",
    "position_m": "position, m",
    "rotation_vector_deg": "rotation vector, deg",
    "leg_lengths_m": "leg lengths, m",
    "tick": "tick",
    "refused_lines": "lines that were no words",
}


def command(bus: BusAddress, words: Sequence[str]) -> dict[str, Any]:
    """Say one command; return the summary. Raises RunError where no controller runs or answers."""
    with OperatorClient(*bus) as client:
        answer = client.say(" ".join(words))
    result = {"success": answer.taken, "kind": "ctl", "command": " ".join(words)}
    return result if answer else result | {"trouble": f"refused: {answer.why}"}


def status(bus: BusAddress) -> dict[str, Any]:
    """Return the controller's status as a summary. Raises RunError where no controller runs or answers."""
    with OperatorClient(*bus) as client:
        return {"success": True, "kind": "ctl", **client.status()}


def status_lines(summary: dict[str, Any]) -> list[str]:
    """Return a status as lines to read."""
    return [f"{title:26s}{_shown(summary[key])}" for key, title in SHOWN.items()]


def _shown(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, list):
        return "  ".join(each if isinstance(each, str) else f"{each:.4f}" for each in value) or "none"
    return f"{value:.4g}" if isinstance(value, float) else str(value) or "nothing"


def hold_key(bus: BusAddress, seconds: float | None = None) -> dict[str, Any]:
    """Send a key frame every 20 ms until Ctrl-C, or for `seconds`; return the summary.

    Its trouble is a controller that ended meanwhile. Raises RunError where none runs.
    """
    sent, begun, trouble = 0, time.monotonic(), dict[str, Any]()
    with OperatorClient(*bus) as client, contextlib.suppress(KeyboardInterrupt):
        try:
            while seconds is None or time.monotonic() - begun < seconds:
                client.key()
                sent += 1
                time.sleep(REPEAT_S)
        except RunError as error:
            if not sent:
                raise
            trouble = {"success": False, "trouble": str(error)}
    return {"success": True, "kind": "ctl", "command": "key", "sent": sent} | trouble


def jog(bus: BusAddress, words: Sequence[str], seconds: float | None = None) -> dict[str, Any]:
    """Say a jog word every 20 ms until Ctrl-C, for `seconds`, or until it is refused; return the summary.

    Its trouble is a controller that refused or ended meanwhile. Raises RunError where none runs or answers.
    """
    line, sent, begun = " ".join(words), 0, time.monotonic()
    result = {"success": True, "kind": "ctl", "command": line}
    with OperatorClient(*bus) as client:
        try:
            with contextlib.suppress(KeyboardInterrupt):
                while seconds is None or time.monotonic() - begun < seconds:
                    answer = client.say(line)
                    if not answer:
                        return result | {"success": False, "sent": sent, "trouble": f"refused: {answer.why}"}
                    sent += 1
                    time.sleep(REPEAT_S)
            client.say(f"jog {words[1]} 0")
        except RunError as error:
            if not sent:
                raise
            return result | {"success": False, "sent": sent, "trouble": str(error)}
    return result | {"sent": sent}
