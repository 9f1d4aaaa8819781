"""The controller's end of CiA 402 drives: the kernels' record, and the start-up dialogue's part in Python."""

from collections.abc import Sequence

import numpy as np

from drivers.arrays import Array, Ints, Rows
from drivers.cia402 import kernels
from drivers.cia402 import objects as o
from drivers.cia402.kernels import MOST_PERMILLE, NOT_ASKED, OPTIONAL
from drivers.cia402.plan import Step
from drivers.cia402.states import ENABLED, UNHEARD
from drivers.controller_end import CompiledController
from drivers.errors import ProtocolError
from drivers.family import Family
from drivers.frame_array import NO_FRAMES, sent_array
from drivers.protocol import DriveSetup, Frame
from drivers.signals import LEGS, Command, DriveMode, DriveState
from drivers.tick_columns import Record

PATIENCE_S = 0.05
"""A request without an answer is repeated after this."""
LEAST_PATIENCE = 6
"""And after so many ticks at least."""
TRIES = 20
"""Requests without an answer after which a drive is asked from the beginning."""
MOST_REQUESTS = 3
"""In a tick."""
_BEATS = 4
"""Heartbeats of ours within the drives' watchdog, where the rate allows."""
_POWERED = (DriveState.READY, DriveState.RUN)


def begun(tables: Rows, setup: DriveSetup, plans: Sequence[Sequence[Step]]) -> Rows:
    """Return the record of a dialogue before its first request."""
    c, rate_Hz = tables.copy(), setup.rate_Hz
    c["period_s"], c["beat"] = 1.0 / rate_Hz, max(2, int(setup.watchdog_s * rate_Hz) // _BEATS)
    c["patience"] = max(LEAST_PATIENCE, round(PATIENCE_S * rate_Hz))
    for leg, (node, plan) in enumerate(zip(c["nodes"].tolist(), plans, strict=True)):
        c["steps"][leg] = len(plan)
        for k, step in enumerate(plan):
            c["requests"][leg, k] = int.from_bytes(step.request(node), "little", signed=True)
            c["values"][leg, k], c["masks"][leg, k] = step.value, step.mask | OPTIONAL * step.optional
    c["asked"], c["states"], c["owed"] = NOT_ASKED, UNHEARD, 1
    return c


class Cia402End(CompiledController):
    """The controller's end. Mutable state: the record, which has the dialogue."""

    first = "patience"

    def __init__(self, family: Family, begun: Rows) -> None:
        """Take the family, and the record of the dialogue before its first request."""
        self._family, self._begun = family, begun
        sync = sent_array(family.to_all(Frame(o.SYNC_ID, b"")))  # without counter
        super().__init__(begun.copy(), kernels.decode, kernels.command, sync[np.newaxis])

    def start(self) -> None:
        """Begin the dialogue: no drive has been set up."""
        self.state[...] = self._begun

    def presume_running(self) -> None:
        """Take all drives for enabled."""
        self.state["states"] = ENABLED

    def unfit(self, force: Array) -> ProtocolError:
        """Return what is wrong with a force that does not fit."""
        most = MOST_PERMILLE / np.abs(self.state["permille_per_N"]).max()
        return ProtocolError(
            f"force command {force.tolist()} N does not fit 0x6071: six of up to {most:.6g} N are "
            "allowed; lower limits.force_N, or correct drives.options.rated_torque_Nm or "
            "drives.transmission"
        )

    def carried(self, force: Array) -> Array:
        """Return what whole thousandths of the rated torque give legs at rest of forces (6,) N."""
        before = self.remembered()
        self.state["stopped"] = 0
        try:
            sent = self.give(Command(DriveMode.RUN, force), 1)[:LEGS]
        finally:
            self.remember(before)
        permille: Ints = sent["data"][:, 2:4].copy().view("<i2")[:, 0]
        carried: Array = permille / self.state["permille_per_N"]
        return carried

    # the start-up dialogue, see `drivers.cia402.plan`

    def set_up(self, tick: Record) -> Rows:
        """Return the requests of a tick; whose turn it is goes round.

        A drive that is heard in READY or RUN is not asked. One in fault whose EMCY was not heard, which was
        sent once, before us or into a loss, is asked why.
        """
        states, ages, codes = (tick[name].tolist() for name in ("drive_state", "age", "drive_fault"))
        done = self.legs_set_up()
        unknown = [state == DriveState.FAULT and not code for state, code in zip(states, codes, strict=True)]
        if all(ready and not fault for ready, fault in zip(done, unknown, strict=True)):
            return NO_FRAMES
        c, number, waits = self.state, int(tick["tick"]), int(self.state["patience"])
        frames: list[Frame] = []
        for k in range(LEGS):
            leg = (number * MOST_REQUESTS + k) % LEGS
            asked = int(c["asked"][leg])
            if (done[leg] and not unknown[leg]) or (asked != NOT_ASKED and number - asked < waits):
                continue
            if states[leg] in _POWERED and ages[leg] < waits:
                continue
            if len(frames) == MOST_REQUESTS:
                break
            frames.append(self._family.to_leg(leg, self._request(leg, number, done=done[leg])))
        return sent_array(frames)

    def _request(self, leg: int, number: int, *, done: bool) -> Frame:
        """Return the request of a drive's step, in a tick. NMT commands but for the last are not answered."""
        c, node = self.state, int(self.state["nodes"][leg])
        if done:
            c["asked"][leg], c["tries"][leg] = number, 0
            return Frame(o.SDO_REQUEST_ID + node, o.upload(o.ERROR_CODE))
        if c["tries"][leg] >= TRIES and c["at"][leg]:
            c["at"][leg] = c["tries"][leg] = 0
        request, value = (int(c[name][leg, c["at"][leg]]) for name in ("requests", "values"))
        c["asked"][leg], c["tries"][leg] = number, c["tries"][leg] + 1
        if request >> 16:
            return Frame(o.SDO_REQUEST_ID + node, request.to_bytes(8, "little", signed=True))
        if value != o.START:
            c["at"][leg], c["asked"][leg], c["tries"][leg] = c["at"][leg] + 1, NOT_ASKED, 0
        return Frame(o.NMT_ID, request.to_bytes(2, "little"))

    def legs_set_up(self) -> tuple[bool, ...]:
        """Return which drives hold on their own word what was set, and answer the SYNC."""
        return tuple((self.state["at"] == self.state["steps"]).tolist())

    def lacks(self) -> tuple[str, ...]:
        """Return the object that a drive refused, reads otherwise or does not answer for."""
        return tuple(map(self._lack, range(LEGS), self.legs_set_up()))

    def _lack(self, leg: int, done: bool) -> str:
        c, refused = self.state, int(self.state["refused"][leg])
        if done:
            return ""
        step = refused - 1 if refused else int(c["at"][leg])
        request, value, mask = (int(c[name][leg, step]) for name in ("requests", "values", "masks"))
        what = o.place((request >> 8 & 0xFFFF, request >> 24 & 0xFF))
        if not refused:
            why = f"no answer to {c['tries'][leg]} requests for {what}"
            return why if request >> 16 else "it sends no TPDO, although it was started by NMT"
        abort, kind = int(c["abort"][leg]), "read" if request & 0xFF == o.UPLOAD else "write"
        if abort:
            return f"{what}: {kind} refused with {o.abort_text(abort)}"
        mask &= OPTIONAL - 1
        return f"{what} is {int(c['read'][leg]) & mask}, expected {value & mask}"
