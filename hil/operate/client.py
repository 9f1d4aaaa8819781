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
from drivers.errors import RunError, require_linux

TAKEN = "taken"
REFUSED = "refused: "
"""The controller's answers to a line; the second is followed by the reason."""
ANSWER_S = 1.0
"""Time to wait for an answer, s."""
_LONGEST = 4096
"""Bytes of an answer, and of a line to send; the controller already refuses far shorter lines as too long."""


def socket_path(interface: str, channel: str) -> Path:
    """Path of the operator socket of the controller on a bus; interface, channel as in section `bus`."""
    return runtime_folder() / f"{safe_name(interface)}.{safe_name(channel)}.operator.sock"


@dataclass(frozen=True)
class Answer:
    """The controller's answer to one command; it is true in a condition if the command was accepted."""

    taken: bool
    """True if the command was accepted."""
    why: str = ""
    """Reason for a refusal, with the allowed values; empty for an accepted command."""

    def __bool__(self) -> bool:
        """True if the command was accepted."""
        return self.taken


@dataclass(frozen=True)
class Streamed:
    """Numbers of set-points sent, accepted and refused in a stream."""

    sent: int
    """Number of set-points sent."""
    taken: int
    """Of these, the number that the controller accepted."""
    refused: int
    """Of these, the number that it refused; the others got no answer."""
    why: str
    """Reason for the last refusal."""
    seconds: float
    """Time from the first set-point to the last answer, s."""


class OperatorClient:
    """Operator's connection to the controller that runs on a bus.

    Each command waits for the controller's answer, which comes with the next tick, and returns it. Mutable
    state: the socket, and the number of lines sent.

    Parameters
    ----------
    interface, channel
        As in section `bus` of the running configuration, for example ``"localcan"``, ``"hil0"``.

    Raises
    ------
    RunError
        No controller listens there; from each command: no answer within 1 s.
    """

    def __init__(self, interface: str, channel: str) -> None:
        require_linux("OperatorClient")
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
                    f"{self._where} has a controller that does not listen here: it runs as another user or "
                    "with another XDG_RUNTIME_DIR (sudo, a service, a session that has ended), is starting, "
                    "or is not `hil run`; operate it from where it was started"
                )
            raise RunError(why) from None

    def arm(self) -> Answer:
        """Allow the platform to move: like Enter in the terminal of `hil run`, or its option --arm."""
        return self.say("arm")

    def start(self) -> Answer:
        """Start or continue the motion along the path."""
        return self.say("start")

    def hold(self) -> Answer:
        """Slow down along the path to rest and stay there: brakes open, the law holds the platform."""
        return self.say("hold")

    def stop(self) -> Answer:
        """Stop along the path, shut the brakes, park: like Ctrl-C."""
        return self.say("stop")

    def park(self) -> Answer:
        """Return to the reference's first pose at set-up speed, close the brakes; ends in mode PARKED."""
        return self.say("park")

    def reset(self) -> Answer:
        """Clear latched faults, of the controller and of the drives."""
        return self.say("reset")

    def estop(self) -> Answer:
        """Switch the drives off at once; their brakes shut. This is not a safety-rated emergency stop."""
        return self.say("estop")

    def end(self) -> Answer:
        """End a run that would continue after parking (operator.stays): stop, park, close the log."""
        return self.say("end")

    def speed(self, percent: float) -> Answer:
        """Set the speed along the path, 0 .. 100 % of the configured one; the speed changes smoothly."""
        return self.say(f"speed {float(percent)!r}")

    def key(self) -> None:
        """Report that the operator holds the enabling key (operator.deadman_s); does not wait for an answer.

        Raises RunError if the controller has ended.
        """
        self._send("key")
        self._arrived()  # who does not read is dropped

    def jog_axis(self, axis: str, fraction: float) -> Answer:
        """Move along x, y or z of the base frame, or rotate about one of them (rx, ry, rz), from hold.

        fraction: of the set-up speed, -1 .. 1. The order lasts for 100 ms: repeat it, for instance at 50 Hz,
        as long as the motion should continue. A refusal gives the reason in the answer.
        """
        return self.say(f"jog {axis} {fraction!r}")

    def jog_leg(self, leg: int, fraction: float) -> Answer:
        """Extend or retract leg 0 .. 5, from hold; the other legs keep their lengths. See `jog_axis`."""
        return self.say(f"jog leg{leg} {fraction!r}")

    def release(self) -> Answer:
        """Release a platform that only drive force holds, as a brake may be open. Support it first."""
        return self.say("release")

    def setpoint(
        self, x: float, y: float, z: float, rx: float = 0.0, ry: float = 0.0, rz: float = 0.0
    ) -> Answer:
        """Send a live set-point: position x, y, z m, rotation vector rx, ry, rz deg, in the base frame."""
        return self.say("setpoint " + " ".join(repr(float(each)) for each in (x, y, z, rx, ry, rz)))

    def stream(self, poses: Iterable[Iterable[float]], rate_Hz: float) -> Streamed:
        """Send set-points (x y z [rx ry rz], m and deg, base frame) at a fixed rate.

        It does not wait for each answer. rate_Hz: at most that of the loop, which in each tick follows the
        last set-point received.
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
        """The controller's status.

        Keys: `mode` and `faults` by name, `tick`, `speed_percent` as requested and `speed_now_percent`,
        `position_m`, `rotation_vector_deg`, `leg_lengths_m` (None where unknown), `path_s` and
        `path_length_s` (None without an end), `held`, `key` (`not needed`, `held` or `missing`), `waits_for`
        (a sentence, or empty), `refused_lines`.
        """
        found: dict[str, Any] = json.loads(self._ask("status"))
        return found

    def say(self, line: str) -> Answer:
        """Send a line of text, for example `speed 40`, and return the controller's answer."""
        answer = self._ask(line)
        return Answer(answer == TAKEN, "" if answer == TAKEN else answer.removeprefix(REFUSED))

    def close(self) -> None:
        """Close the connection to the controller."""
        self._socket.close()

    def _send(self, line: str) -> str:
        """Send a line with a new tag; returns the tag, which the answer repeats."""
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
        """Texts of the answers received so far, without their tags."""
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
