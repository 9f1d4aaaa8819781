"""`hil ctl` and `hil setpoint`: an operator's words to a running controller, from a terminal."""

import contextlib
import time
from collections.abc import Iterable, Sequence
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


def repeat(bus: BusAddress, words: Sequence[str], seconds: float | None = None) -> dict[str, Any]:
    """Hold the key, or repeat a jog word, until Ctrl-C or for `seconds`; return the summary.

    Its trouble is a controller that refused the word or ended meanwhile. Raises RunError where none runs or
    answers.
    """
    line, sent, begun, trouble = " ".join(words), 0, time.monotonic(), ""
    with OperatorClient(*bus) as client:
        try:
            with contextlib.suppress(KeyboardInterrupt):
                while seconds is None or time.monotonic() - begun < seconds:
                    if line == "key":
                        client.key()
                    elif not (answer := client.say(line)):
                        trouble = f"refused: {answer.why}"
                        break
                    sent += 1
                    time.sleep(REPEAT_S)
            if line != "key" and not trouble:
                client.say(f"jog {words[1]} 0")
        except RunError as error:
            if not sent:
                raise
            trouble = str(error)
    result = {"success": not trouble, "kind": "ctl", "command": line, "sent": sent}
    return result | {"trouble": trouble} if trouble else result


def send_setpoints(bus: BusAddress, lines: Iterable[str]) -> dict[str, Any]:
    """Send each line `x y z [rx ry rz]` (m, deg) as it comes; return the summary.

    A controller that ends meanwhile is trouble of the summary, which says how many it had taken. Raises
    RunError when no controller listens, or none answers the first line.
    """
    sent, taken, refused, trouble = 0, 0, list[str](), ""
    with OperatorClient(*bus) as client:
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
