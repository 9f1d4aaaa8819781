"""The controller's end of what CiA 402 drives send: TPDOs to SI, state, EMCY, boot-up, SDO answers."""

import struct
from collections.abc import Sequence

import numpy as np

from drivers.arrays import Rows
from drivers.cia402 import objects as o
from drivers.cia402.set_up import Cia402Dialogue, Slope, advanced, answered, moved, put
from drivers.cia402.states import DRIVE_STATE, STATE_OF, UNHEARD, State
from drivers.frame_array import received_frames
from drivers.protocol import ERROR, EXTENDED, FD, OTHER_BUSES, REMOTE
from drivers.signals import LEGS, NEVER, DriveFault, DriveState, Foreign
from drivers.tick_columns import Record
from drivers.transmission import Transmission

FOREIGN = EXTENDED | FD | REMOTE | ERROR | OTHER_BUSES
"""Flags of frames that cannot be ours."""
OLDEST = 50
"""Ticks after which a difference of lengths says nothing of the rate."""
STRAYING = 8
"""Ticks after a drive was missed within which what it still owes may come: a stall shifts answers."""
SHORTEST = 0.5
"""Periods; a stall leaves shorter steps, over which the steps of the encoder make too rough a rate."""
_PLACE, _SPEED, _SDO, _BEAT, _EMERGENCY, _OTHER = range(6)
"""Kinds of frames."""
_TPDO1, _TPDO2 = struct.Struct("<Hih"), struct.Struct("<i")
_SIZES = {_PLACE: _TPDO1.size, _SPEED: _TPDO2.size}
_EMERGENCY_BYTES = 8
_NMT_STATES = (o.BOOTS, o.STOPPED, o.OPERATES, o.PREPARES)
_HALTED = (State.DISABLED, State.READY_TO_SWITCH_ON, State.QUICK_STOP)


class Feedback:
    """Decoder of six drives. Holds tables only."""

    def __init__(
        self,
        nodes: Sequence[int],
        transmission: Transmission,
        N_per_permille: Sequence[float],
        velocity: bool,
        controller_node: int,
    ) -> None:
        self._velocity = velocity
        self._transmission = transmission
        lossless = (transmission.driving == 1.0).all() and (transmission.back_driving == 1.0).all()
        self._lossless = bool(lossless)
        self._m_per_count = (transmission.m_per_turn / transmission.counts).tolist()
        self._offset = transmission.offset_m.tolist()
        self._N_per_permille = list(N_per_permille)
        kinds: dict[int, tuple[int, int]] = {
            o.SYNC_ID: (_OTHER, Foreign.SYNC),
            o.NMT_ID: (_OTHER, Foreign.CONFIG),
            o.HEARTBEAT_ID + controller_node: (_OTHER, Foreign.COMMAND),
        }
        for leg, node in enumerate(nodes):
            kinds[o.TPDO_ID[0] + node] = _PLACE, leg
            if velocity:
                kinds[o.TPDO_ID[1] + node] = _SPEED, leg
            kinds[o.SDO_REPLY_ID + node] = _SDO, leg
            kinds[o.HEARTBEAT_ID + node] = _BEAT, leg
            kinds[o.EMCY_ID + node] = _EMERGENCY, leg
            kinds[o.RPDO_ID[0] + node] = _OTHER, Foreign.COMMAND
            kinds[o.SDO_REQUEST_ID + node] = _OTHER, Foreign.CONFIG
        self._kinds = kinds
        self.sizes = {identifier: _SIZES[kind] for identifier, (kind, _) in kinds.items() if kind in _SIZES}
        """Bytes of each TPDO, by its identifier."""
        self.ids = frozenset(self.sizes)

    def fold(
        self, dialogue: Cia402Dialogue, frames: Rows, last: Record, tick: Record, since_ns: int
    ) -> Cia402Dialogue:
        """Fill the measurement of a tick from that of the last one and the frames since.

        since_ns: when the loop woke up. A TPDO that came after this tick's SYNC had ended answers it; an
        earlier one answers the last one, and counts with age 1 if nothing newer is held. Refused, and counted
        in `rejected`: a wrong length, a statusword or an NMT state that there is not, an SDO frame that is no
        expedited answer. A second TPDO of a tick with other data makes the node `doubled`, and the first one
        counts; unless the drive owes one to an earlier SYNC since it was missed within the last STRAYING
        ticks: then the last one counts. A leg is as old as the older one of its two TPDOs. Boot-up, and a
        drive that has left Operational, begin its set-up anew.
        """
        heard = _Heard(dialogue, last, tick)
        number = int(tick["tick"])
        synced_ns = [since_ns + delay for delay in tick["latch_ns"].tolist()]
        for t_ns, (identifier, data, flags) in received_frames(frames):
            found = self._kinds.get(identifier)
            if found is None or flags & FOREIGN:
                continue
            kind, leg = found
            if kind <= _SPEED:
                if len(data) != _SIZES[kind] or (kind == _PLACE and STATE_OF[data[0] & 0x7F] == UNHEARD):
                    heard.rejected += 1
                else:
                    heard.take(kind, leg, data, late=t_ns < synced_ns[leg])
            elif kind == _OTHER:
                heard.foreign |= leg
            else:
                dialogue = self._spoken(dialogue, kind, leg, data, heard, number)
        return self._close(dialogue, heard, last, tick)

    @staticmethod
    def _spoken(
        dialogue: Cia402Dialogue, kind: int, leg: int, data: bytes, heard: "_Heard", number: int
    ) -> Cia402Dialogue:
        """Take what is no TPDO."""
        if kind == _EMERGENCY:
            if len(data) == _EMERGENCY_BYTES:
                heard.fault[leg] = data[0] | data[1] << 8
            else:
                heard.rejected += 1
            return dialogue
        if kind == _SDO:
            following = answered(dialogue, leg, data, number)
            heard.rejected += following is None
            reply = o.read_reply(data)
            if reply is not None and reply.key == o.ERROR_CODE and heard.state[leg] == DriveState.FAULT:
                heard.fault[leg] = heard.fault[leg] or (0 if reply.abort else reply.value)
            return dialogue if following is None else following
        if len(data) != 1 or data[0] not in _NMT_STATES:
            heard.rejected += 1
            return dialogue
        booted = data[0] == o.BOOTS
        if booted or (data[0] != o.OPERATES and dialogue.done(leg)):
            heard.state[leg] = DriveState.BOOT
            heard.places[leg] = None
            if booted:
                heard.fault[leg] = DriveFault.NONE
            states = put(dialogue.states, leg, UNHEARD)
            return moved(dialogue, leg, 0)._replace(states=states)
        return dialogue

    def _close(self, dialogue: Cia402Dialogue, heard: "_Heard", last: Record, tick: Record) -> Cia402Dialogue:
        """Put what was heard into the tick."""
        length, rate, force = (last[name].tolist() for name in ("length", "rate", "drive_force"))
        states, stopped = list(dialogue.states), dialogue.stopped
        slopes, latched_ns = list(dialogue.slopes), (_latched_ns(tick), _latched_ns(last))
        for leg in range(LEGS):
            place, speed = heard.places[leg], heard.speeds[leg]
            if place is None:
                continue
            data, late = place
            word, count, torque = _TPDO1.unpack(data)
            state = STATE_OF[word & 0x7F]
            if state == State.QUICK_STOP or (states[leg] == State.ENABLED and state == State.DISABLED):
                stopped |= 1 << leg
            states[leg] = state
            heard.state[leg] = DRIVE_STATE[state]
            force[leg] = torque * self._N_per_permille[leg]
            if self._velocity and (speed is None or (speed[1] and not late)):
                continue
            here = self._offset[leg] + self._m_per_count[leg] * count
            if speed is not None:
                rate[leg] = self._m_per_count[leg] * _TPDO2.unpack(speed[0])[0]
            else:
                period_s, slope = 1.0 / dialogue.setup.rate_Hz, slopes[leg]
                rate[leg], slopes[leg] = difference(here, latched_ns[late][leg], slope, rate[leg], period_s)
            length[leg], heard.age[leg] = here, int(late)
            if not late and dialogue.asked[leg] >= 0:
                step = dialogue.step(leg)
                if step is not None and step.kind == "nmt":
                    dialogue = advanced(dialogue, leg)
        for leg in range(LEGS):
            if stopped >> leg & 1 and states[leg] in _HALTED:
                heard.state[leg] = DriveState.FAULT
                heard.fault[leg] = heard.fault[leg] or DriveFault.ESTOP
            elif not stopped >> leg & 1 and heard.fault[leg] == DriveFault.ESTOP:
                heard.fault[leg] = DriveFault.NONE
        tick["length"], tick["rate"] = length, rate
        tick["drive_force"] = (
            force if self._lossless else self._transmission.delivered(np.array(force), np.array(rate))
        )
        heard.fill(tick)
        return dialogue._replace(
            states=tuple(states),
            stopped=stopped,
            rate=tuple(rate),
            slopes=tuple(slopes),
            owed=tuple(min(n, STRAYING) for n in heard.owed),
            missed=tuple(heard.missed),
        )


def difference(
    length: float, latched_ns: int, before: Slope, rate: float, period_s: float
) -> tuple[float, Slope]:
    """Return the rate at the end of a step from the last two mean rates, and what the next one needs.

    dq = d1 + (d1 - d0) T1 / (T1 + T0), the slope at the end of the parabola through the last three lengths:
    the mean rate d1 of the step alone is that of T1 / 2 ago. T from SYNC to SYNC as the bus carried them: at
    400 Hz one that is 25 us late moves a leg by 1 % of its step. A step shorter than SHORTEST periods leaves
    the rate as it was read last, m/s, and is part of the next one; after OLDEST periods the rate begins at 0.
    """
    d0, T0, was_ns, was = before
    T1 = 1e-9 * (latched_ns - was_ns)
    if was is None or OLDEST * period_s < T1:
        return 0.0, Slope(latched_ns=latched_ns, length=length)
    if SHORTEST * period_s > T1:
        return rate, before
    d1 = (length - was) / T1
    return d1 + ((d1 - d0) * T1 / (T1 + T0) if T0 else 0.0), Slope(d1, T1, latched_ns, length)


def _latched_ns(record: Record) -> list[int]:
    """Return when the SYNC of a tick ended on the bus of each leg."""
    woke_ns = int(record["t_ns"]) + int(record["lateness_ns"])
    return [woke_ns + delay for delay in record["latch_ns"].tolist()]


class _Heard:
    """What a tick has brought so far. State: all of it."""

    def __init__(self, dialogue: Cia402Dialogue, last: Record, tick: Record) -> None:
        number, before = int(tick["tick"]), int(last["tick"])
        gone = number - before if before >= 0 else 1
        ages = last["age"].tolist()
        self.age = [min(NEVER, age + gone) for age in ages]
        self.missed = [before if age else then for age, then in zip(ages, dialogue.missed, strict=True)]
        lately = [number - then <= STRAYING for then in self.missed]
        self.owed = [1 + n * late for n, late in zip(dialogue.owed, lately * len(_SIZES), strict=True)]
        """TPDOs that may still come from each drive, that to this tick's SYNC included; by kind, then leg."""
        self.state = last["drive_state"].tolist()
        self.fault = last["drive_fault"].tolist()
        self.places: list[tuple[bytes, bool] | None] = [None] * LEGS
        """TPDO1 of each leg, and whether it is late."""
        self.speeds: list[tuple[bytes, bool] | None] = [None] * LEGS
        self.rejected = self.foreign = self.doubled = 0

    def take(self, kind: int, leg: int, data: bytes, *, late: bool) -> None:
        """Keep a TPDO, if it is newer than what is there and its drive owes it."""
        if late and self.age[leg] <= 1:
            return
        held, slot = (self.places if kind == _PLACE else self.speeds), kind * LEGS + leg
        first = held[leg]
        if first is not None and first[0] == data:
            held[leg] = data, late
        elif self.owed[slot] > 0:
            self.owed[slot] -= 1
            held[leg] = data, late
        else:
            self.doubled |= 1 << leg

    def fill(self, tick: Record) -> None:
        """Put the columns in that need no scale."""
        tick["age"] = tick["counted_age"] = self.age
        tick["drive_state"], tick["drive_fault"] = self.state, self.fault
        tick["blind"] = 0
        tick["rejected"], tick["foreign"] = self.rejected, self.foreign
        tick["doubled"], tick["altered"] = self.doubled, 0
