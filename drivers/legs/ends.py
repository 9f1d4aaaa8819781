"""Both ends of the own protocol; they are compiled in `drivers.legs.kernels` and `device_kernels`."""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.arrays import Array, Rows
from drivers.controller_end import CompiledController
from drivers.ends import CompiledDrives
from drivers.errors import ProtocolError
from drivers.frame_array import NO_FRAMES, sent_array
from drivers.legs import device_kernels, kernels
from drivers.legs.crc import seals
from drivers.legs.messages import set_up_checksum
from drivers.protocol import (
    ALL_LEGS,
    Configure,
    DeviceMessage,
    DriveSetup,
    EmergencyStop,
    Frame,
    Rejected,
    Status,
)
from drivers.signals import LEGS, DriveState, Reaction
from drivers.tick_columns import Record

TRIES = 10
"""How often a drive that does not confirm its set-up is sent its CONFIG."""
SETUP_S = 0.02
"""From one CONFIG of a drive to its next."""
NOT_HEARD = -1
"""Said by a drive whose status has not been heard."""
_NEWEST = 8
"""Versions of the protocol that are tried."""
_POWERED = (DriveState.READY, DriveState.RUN)
_REASONS = (
    "length or CRC of SYNC",
    "repeated SYNC",
    "command of {size} bytes",
    "CRC of a command",
    "unknown mode",
    "force not finite or out of range",
    "command {counter} while the present SYNC is {present}",
)
"""By the numbers of `drivers.legs.device_kernels`."""


class LegsController(CompiledController):
    """The controller's end. Mutable state: the record."""

    first = "expected"

    def __init__(self, family: Any, setup: DriveSetup) -> None:
        """Begin the dialogue. Raises ProtocolError if the watchdog does not fit."""
        self._family, self._setup = family, setup
        super().__init__(family.tables.copy(), kernels.decode, kernels.command, family.syncs)

    def start(self) -> None:
        """Begin the dialogue: no drive has been set up."""
        s, (watchdog_s, reaction, rate_Hz) = self.state, self._setup
        s["watchdog"], s["reaction"] = self._family.watchdog(watchdog_s), reaction
        s["expected"] = [self._checksum(leg, *self._sent(leg)) for leg in ALL_LEGS]
        s["interval"] = max(LEGS, round(SETUP_S * rate_Hz))
        s["sent"], s["confirmed"], s["said"] = 0, 0, NOT_HEARD

    def _sent(self, leg: int) -> tuple[int, ...]:
        """Return the fields of a drive's CONFIG."""
        s = self.state
        return int(s["watchdog"]), int(s["reaction"]), int(s["place"][leg]), int(s["version"])

    def _checksum(self, leg: int, *values: int) -> int:
        """Return what a drive says of its set-up whose CONFIG has these fields."""
        body = self._family.messages.config.pack(*values)[:-1]
        return set_up_checksum(int(self.state["config"][leg]), body, self._family.rated_force_N)

    def set_up(self, tick: Record) -> Rows:
        """Return the CONFIG of a drive that is heard and has none from us or does not confirm it, one a tick.

        A drive that is out of boot gets it TRIES times at most.
        """
        s, leg = self.state, int(tick["tick"]) % int(self.state["interval"])
        if leg >= LEGS or tick["age"][leg] > 1:
            return NO_FRAMES
        state = tick["drive_state"][leg]
        enough = s["sent"][leg] >= (1 if s["confirmed"] >> leg & 1 else TRIES)
        if state != DriveState.BOOT and (enough or state in _POWERED):
            return NO_FRAMES
        s["sent"][leg] += 1
        return sent_array([self._family.config(leg, *self._sent(leg))])

    def legs_set_up(self) -> tuple[bool, ...]:
        """Tell which drives have been sent their CONFIG and have confirmed it."""
        confirmed, sent = int(self.state["confirmed"]), self.state["sent"].tolist()
        return tuple([sent[leg] > 0 and confirmed >> leg & 1 == 1 for leg in ALL_LEGS])

    def lacks(self) -> tuple[str, ...]:
        """Return which value of its CONFIG each drive has not confirmed; empty: it has confirmed all.

        A status has a checksum of the set-up. A watchdog and a rated force can have so many values that it
        names none.
        """
        return tuple("" if done else self._lack(leg) for leg, done in enumerate(self.legs_set_up()))

    def _lack(self, leg: int) -> str:
        times, said, expected = (int(self.state[name][leg]) for name in ("sent", "said", "expected"))
        if not times:
            return "it was sent no CONFIG"
        if said in (NOT_HEARD, expected):
            return f"no status of it was heard that confirms one of {times} CONFIG"
        if said == 0:
            return "it reports no set-up: it has accepted no CONFIG"
        sent = self._sent(leg)
        names = "reaction", "leg", "version of the protocol"
        for k, values in enumerate((range(len(Reaction)), range(1, LEGS + 1), range(_NEWEST)), 1):
            for value in values:
                if value != sent[k] and self._checksum(leg, *sent[:k], value, *sent[k + 1 :]) == said:
                    shown, known = ((Reaction(v).name.lower() if k == 1 else v) for v in (value, sent[k]))
                    return f"its checksum is that of {names[k - 1]} {shown}, sent was {known}"
        watchdog_ms = 1e3 * sent[0] * self.state["watchdog_s"]
        return (
            f"its checksum is 0x{said:04X}, not 0x{expected:04X}, and fits no other reaction, leg or version "
            f"alone: watchdog (sent: {watchdog_ms:g} ms), rated force (drives.force_limit_N: "
            f"{self._family.rated_force_N:g} N) or several values differ"
        )

    def unfit(self, force: Array) -> ProtocolError:
        """Return that a force does not fit, with the forces of the first bus on which that is so."""
        s, of, shown = self.state, self._family.messages.commands[0][0], force
        for legs in self._family.legs if force.shape == (LEGS,) else ():
            shown = np.zeros(LEGS)
            shown[: len(legs)] = force[list(legs)]
            steps = shown if self._family.exact else np.rint(shown / s["step"])
            if not ((s["least"] <= steps) & (steps <= s["most"])).all():
                break
        return ProtocolError(
            f"force command {shown.tolist()} N does not fit layout {self._family.layout}: {of.low[0]:.12g} "
            f"to {of.high[0]:.12g} N are allowed; lower limits.force_N or choose another bus.layout"
        )


class LegsDrives(CompiledDrives):
    """Six drives. Mutable state: Cycle of the present SYNC of each bus, in the record."""

    def __init__(self, family: Any) -> None:
        self._family = family
        k = device_kernels
        super().__init__(family.tables.copy(), k.parse, k.answer, k.report)

    def reason(self, why: int, counter: int, _number: float, frame: Frame) -> str:
        """Return why a SYNC or a command is rejected."""
        present = self.record["present"][frame.bus]
        return _REASONS[why].format(size=len(frame.data), counter=counter, present=present)

    def converse(self, frame: Frame) -> tuple[DeviceMessage, ...]:
        """Take an E-stop, whatever its payload, or a CONFIG."""
        there, config = self._family.legs[frame.bus], self.record["config"].tolist()
        if frame.id not in config:
            return (EmergencyStop(tuple(sorted(there))),)
        leg = config.index(frame.id)
        said = self._configured(leg, frame)
        return (said,) if leg in there or isinstance(said, Rejected) else ()

    def _configured(self, leg: int, frame: Frame) -> DeviceMessage:
        of, version = self._family.messages.config, self.record["version"]
        if len(frame.data) != of.length or not seals(frame.id, frame.data):
            return Rejected("length or CRC of CONFIG")
        watchdog, reaction, place, given, _ = of.unpack(frame.data)
        if given != version:
            return Rejected(f"CONFIG of version {given} of the protocol, this drive has {version}")
        if watchdog < 1 or reaction >= len(Reaction) or place != self.record["place"][leg]:
            return Rejected(f"CONFIG with watchdog {watchdog} us, reaction {reaction}, leg {place}")
        return Configure(leg, watchdog * of.scale[0], Reaction(reaction))

    def notify(self, status: Status) -> tuple[Frame, ...]:
        """Raise the ProtocolError of a watchdog that no CONFIG could have set."""
        assert status.set_up is not None
        self._family.watchdog(status.set_up.watchdog_s)
        return ()
