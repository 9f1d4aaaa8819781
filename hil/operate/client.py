"""The operator's end of the channel: one connection to a running controller."""

import contextlib
import json
import socket
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from drivers.can.runtime_folder import role_holder, runtime_folder, safe_name
from drivers.errors import RunError

TAKEN = "taken"
REFUSED = "refused: "
"""What the controller answers to a line; behind the latter stands the reason."""
ANSWER_S = 1.0
"""How long an answer is waited for."""
_LONGEST = 4096
"""Bytes of an answer, and of a line that is sent; the controller refuses far shorter ones as too long."""


def socket_path(interface: str, channel: str) -> Path:
    """Return where the controller on a bus listens to its operator."""
    return runtime_folder() / f"{safe_name(interface)}.{safe_name(channel)}.operator.sock"


@dataclass(frozen=True)
class Answer:
    """What the controller said to one command; true where it was taken."""

    taken: bool
    """Whether the command counts."""
    why: str = ""
    """Why it was refused, and what is allowed; empty where it was taken."""

    def __bool__(self) -> bool:
        """Whether it was taken."""
        return self.taken


@dataclass(frozen=True)
class Streamed:
    """What became of a stream of set-points."""

    sent: int
    """Set-points that were sent."""
    taken: int
    """Of these, those that the controller followed."""
    refused: int
    """Of these, those that it refused; what is neither was not answered."""
    why: str
    """Why the last refused one was."""
    seconds: float
    """s from the first one to the last answer."""


class OperatorClient:
    """Speaks to the controller that runs on a bus, as its operator.

    Each command waits for the controller's answer, which comes with the next tick, and returns it. Mutable
    state: the socket, and how many lines were sent.

    Parameters
    ----------
    interface, channel
        Those of section `bus` of the configuration that runs, as ``"localcan"``, ``"hil0"``.

    Raises
    ------
    RunError
        No controller listens there; from each command: none answered within 1 s.

    """

    def __init__(self, interface: str, channel: str) -> None:
        self._where = f"bus {interface}:{channel}"
        self._number = 0
        path = socket_path(interface, channel)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_CLOEXEC)
        self._socket.settimeout(ANSWER_S)
        try:
            self._socket.connect(str(path))
        except OSError:
            self._socket.close()
            why = f"no controller runs on {self._where}: start `hil run` there first"
            if role_holder(interface, channel, "controller") is not None:
                why = (
                    f"{self._where} has a controller, but none that listens here: it runs as another user or "
                    "with another XDG_RUNTIME_DIR (sudo, a service, a session that has ended), is starting, "
                    "or is no `hil run`; speak to it from where it was started"
                )
            raise RunError(why) from None

    def arm(self) -> Answer:
        """Let the platform move: as Enter in the terminal of `hil run`, or its option --arm."""
        return self.say("arm")

    def start(self) -> Answer:
        """Go on along the path, or begin it."""
        return self.say("start")

    def hold(self) -> Answer:
        """Slow down along the path to rest and stay: brakes open, the law holds the platform."""
        return self.say("hold")

    def stop(self) -> Answer:
        """Stop along the path, shut the brakes, park: as Ctrl-C."""
        return self.say("stop")

    def park(self) -> Answer:
        """Go back to the first pose of the reference at set-up speed, shut the brakes, park."""
        return self.say("park")

    def reset(self) -> Answer:
        """Clear latched faults, of the controller and of the drives."""
        return self.say("reset")

    def estop(self) -> Answer:
        """Switch the drives off at once; their brakes shut. No safety-rated emergency stop."""
        return self.say("estop")

    def end(self) -> Answer:
        """End a run that stays (operator.stays): stop, park, close the log."""
        return self.say("end")

    def speed(self, percent: float) -> Answer:
        """Set the speed along the path in percent of the configured one, 0 .. 100; it changes smoothly."""
        return self.say(f"speed {float(percent)!r}")

    def key(self) -> None:
        """Say that the operator holds the key (operator.deadman_s). No answer is waited for.

        Raises RunError where the controller has gone.
        """
        self._send("key")
        self._arrived()  # who does not read is dropped

    def jog_axis(self, axis: str, fraction: float) -> Answer:
        """Move along x, y or z of the base frame, or turn about one (rx, ry, rz), from hold.

        fraction: of the set-up speed, -1 .. 1. It lasts for 100 ms: say it again, at 50 Hz for instance, for
        as long as it is to go on. The answer says why it does not.
        """
        return self.say(f"jog {axis} {fraction!r}")

    def jog_leg(self, leg: int, fraction: float) -> Answer:
        """Make leg 0 .. 5 longer or shorter, from hold; the other five keep their lengths. See `jog_axis`."""
        return self.say(f"jog leg{leg} {fraction!r}")

    def release(self) -> Answer:
        """Let go of a platform that force holds because its brakes are not proven shut. Support it first."""
        return self.say("release")

    def setpoint(
        self, x: float, y: float, z: float, rx: float = 0.0, ry: float = 0.0, rz: float = 0.0
    ) -> Answer:
        """Send a live reference to a pose: m, and the rotation vector in deg, in the base frame."""
        return self.say("setpoint " + " ".join(repr(float(each)) for each in (x, y, z, rx, ry, rz)))

    def stream(self, poses: Iterable[Iterable[float]], rate_Hz: float) -> Streamed:
        """Send set-points (x y z [rx ry rz], m and deg) at a fixed rate, without waiting for each answer.

        rate_Hz: at most that of the loop, of which each tick follows the last set-point that has come.
        """
        sent, answers = 0, list[str]()
        begun = time.perf_counter()
        for pose in poses:
            wait = begun + sent / rate_Hz - time.perf_counter()
            if wait > 0.0:
                time.sleep(wait)
            self._send("setpoint " + " ".join(repr(float(x)) for x in pose))
            sent += 1
            answers += self._arrived()
        until = time.perf_counter() + ANSWER_S
        while len(answers) < sent and time.perf_counter() < until:
            time.sleep(1e-3)
            answers += self._arrived()
        refused = [answer.removeprefix(REFUSED) for answer in answers if answer != TAKEN]
        seconds = time.perf_counter() - begun
        return Streamed(sent, len(answers) - len(refused), len(refused), (refused or [""])[-1], seconds)

    def status(self) -> dict[str, Any]:
        """Return what the controller says of itself.

        Keys: `mode` and `faults` by name, `tick`, `speed_percent` asked for and `speed_now_percent`,
        `position_m`, `rotation_vector_deg`, `leg_lengths_m` (None where they are not known), `path_s` and
        `path_length_s` (None without an end), `held`, `key` (`not needed`, `held` or `missing`),
        `waits_for` (a sentence, or empty), `refused_lines`.
        """
        found: dict[str, Any] = json.loads(self._ask("status"))
        return found

    def say(self, line: str) -> Answer:
        """Send a line of the channel, as `speed 40`, and return the answer."""
        answer = self._ask(line)
        return Answer(answer == TAKEN, "" if answer == TAKEN else answer.removeprefix(REFUSED))

    def close(self) -> None:
        """Give the socket back."""
        self._socket.close()

    def _send(self, line: str) -> str:
        """Send a line; return the tag of its answer."""
        self._number += 1
        tag = f"#{self._number}"
        try:
            self._socket.send(f"{tag} {line}".encode(errors="replace")[:_LONGEST])
        except OSError:
            raise RunError(
                f"the controller on {self._where} does not listen any more: has it ended?"
            ) from None
        return tag

    def _ask(self, line: str) -> str:
        tag = self._send(line)
        with contextlib.suppress(OSError):
            while data := self._socket.recv(_LONGEST):
                found, _, answer = data.decode().partition(" ")
                if found == tag:  # an older one answers what was given up
                    return answer
        raise RunError(f"the controller on {self._where} did not answer within {ANSWER_S:g} s: has it ended?")

    def _arrived(self) -> list[str]:
        """Return the answers that have come, without their tags."""
        answers = []
        self._socket.settimeout(0.0)
        with contextlib.suppress(OSError):
            while data := self._socket.recv(_LONGEST):
                answers.append(data.decode().partition(" ")[2])
        self._socket.settimeout(ANSWER_S)
        return answers

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
