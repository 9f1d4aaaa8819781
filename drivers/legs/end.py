"""The controller's end of the own protocol: its dialogue; what is compiled is in `drivers.legs.kernels`."""

from typing import Any

import numpy as np

from drivers.arrays import Array, Rows
from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import pointed
from drivers.controller_end import CompiledController
from drivers.errors import ProtocolError
from drivers.frame_array import NO_FRAMES, sent_array
from drivers.frame_pointers import frame_at, place_of
from drivers.legs import kernels
from drivers.legs.kernels import STRANGE, ends, intact
from drivers.legs.messages import set_up_checksum
from drivers.protocol import ALL_LEGS, DriveSetup
from drivers.signals import LEGS, DriveState
from drivers.tick_columns import Record

TRIES = 10
"""How often a drive that does not confirm its set-up is sent its CONFIG."""
SETUP_S = 0.02
"""From one CONFIG of a drive to its next."""
NOT_HEARD = -1
"""Said by a drive whose status has not been heard."""
_POWERED = (DriveState.READY, DriveState.RUN)


@pointed(ends, INTEGER, INTEGER, INTEGER)
def fresh(e: Any, frame_address: int, tick: int, since_ns: int) -> int:
    """Return the leg, from 1 on, of an intact feedback to this tick's SYNC on its own bus; else 0."""
    frame = frame_at(frame_address)
    identifier: Any = np.int64(frame.id)
    leg = place_of(identifier, e.feedback)
    good = leg >= 0 and frame.bus == e.home[leg] and not frame.flags & STRANGE
    good = good and frame.length == e.feedback_length and frame.t_ns >= since_ns
    good = good and (tick - np.int64(frame.data[e.counter_at])) & 0xF == 0
    return leg + 1 if good and intact(frame) else 0


@pointed(ends, INTEGER)
def addressed(e: Any, frame_address: int) -> int:
    """Return which legs on its bus a frame is for, bit i: leg i. Only a CONFIG is for one."""
    frame = frame_at(frame_address)
    identifier: Any = np.int64(frame.id)
    only, legs = place_of(identifier, e.config), 0
    for leg in range(LEGS):
        if frame.bus == e.home[leg] and only in (-1, leg):
            legs |= 1 << leg
    return legs


class LegsController(CompiledController):
    """The controller's end. Mutable state: the record."""

    first = "expected"

    def __init__(self, family: Any, setup: DriveSetup) -> None:
        """Begin the dialogue. Raises ProtocolError if the watchdog does not fit."""
        configs, begun = family.configure(setup.watchdog_s, setup.reaction), family.tables.copy()
        self._family, self._configs = family, sent_array(configs)
        begun["expected"] = [set_up_checksum(n, data[:-1], family.rated_force_N) for n, data, _ in configs]
        begun["interval"], begun["said"] = max(LEGS, round(SETUP_S * setup.rate_Hz)), NOT_HEARD
        super().__init__(begun, kernels.decode, kernels.command, family.syncs)

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
        return self._configs[leg : leg + 1]

    def legs_set_up(self) -> tuple[bool, ...]:
        """Tell which drives have been sent their CONFIG and have confirmed it."""
        confirmed, sent = int(self.state["confirmed"]), self.state["sent"].tolist()
        return tuple([sent[leg] > 0 and confirmed >> leg & 1 == 1 for leg in ALL_LEGS])

    def lack(self, leg: int) -> str:
        """Return why a drive is not taken for set up; a status has a checksum of the set-up alone."""
        times, said, expected = (int(self.state[name][leg]) for name in ("sent", "said", "expected"))
        if self.legs_set_up()[leg]:
            return ""
        if not times:
            return "it was sent no CONFIG"
        if said in (NOT_HEARD, expected):
            return f"no status of it was heard that confirms one of {times} CONFIG"
        if said == 0:
            return "it reports no set-up: it has accepted no CONFIG"
        return (
            f"its set-up has checksum 0x{said:04X}, not 0x{expected:04X}: it holds another than the CONFIG "
            f"sent, or its rated force is not drives.force_limit_N, {self._family.rated_force_N:g} N"
        )

    def unfit(self, force: Array) -> ProtocolError:
        """Return that a force does not fit, with the forces of the first bus on which that is so."""
        s, of, shown = self.state, self._family.commands[0][0], force
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
