"""What the page may say to the controller, and the controller's answer."""

import json
from typing import Any

from drivers.errors import HilError
from hil.operate.client import OperatorClient
from hil.operate.words import parse

WORDS = frozenset({"arm", "start", "hold", "stop", "park", "reset", "estop", "speed", "jog", "key"})
"""Of the operator's words, those that the page has controls for."""
KEY = "key"


def line_of(body: bytes) -> str:
    """Return the operator's line of a request, `{"line": "speed 40"}`, a space between its words.

    Raises ValueError for any other.
    """
    found = json.loads(body)
    if not isinstance(found, dict) or set(found) != {"line"} or not isinstance(found["line"], str):
        raise ValueError('allowed: {"line": "word [numbers]"}')
    line: str = found["line"]
    words = line.split()
    if not line.isprintable() or not words or words[0] not in WORDS:
        raise ValueError(f"allowed words: {', '.join(sorted(WORDS))}")
    parse(line)
    return " ".join(words)


class Operating:
    """Speaks to the controller on a bus, one connection a command: none of them waits for another."""

    def __init__(self, interface: str, channel: str) -> None:
        self._bus = interface, channel

    def say(self, line: str) -> tuple[bool, str]:
        """Return whether the controller took a line, and else why not."""
        try:
            with OperatorClient(*self._bus) as client:
                if line == KEY:
                    client.key()
                    return True, ""
                answer = client.say(line)
        except HilError as error:
            return False, str(error)
        return answer.taken, answer.why

    def status(self) -> dict[str, Any] | None:
        """Return what the controller says of itself; None where none answers."""
        try:
            with OperatorClient(*self._bus) as client:
                return client.status()
        except (HilError, ValueError):
            return None
