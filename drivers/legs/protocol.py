"""The protocol `legs`: at start its tables are built from legs.dbc for the kernels.

No state, no clock. `docs/guides/protocol.md` has the rules of both ends.
"""

from collections.abc import Sequence
from functools import cache, cached_property
from math import isfinite
from typing import Any

import numpy as np

from drivers.arrays import Array, Rows
from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import data_at, pointed
from drivers.config import BusSettings, DriveSettings
from drivers.controller_end import ControllerEnd
from drivers.errors import ConfigurationError, ProtocolError
from drivers.family import Family
from drivers.frame_array import NO_FRAMES, sent_array, sent_frames
from drivers.frame_pointers import EVERYONE, frame_at, legs_of, place_of
from drivers.legs import kernels
from drivers.legs.crc import intact
from drivers.legs.kernels import COMMAND, ENDS, EXACT, NO_SYNC, QUANTITIES, STRANGE, ends
from drivers.legs.messages import COMMANDS, SHORT, read_messages, set_up_checksum
from drivers.protocol import ALL_LEGS, DriveSetup, Frame, Resolution, Traits
from drivers.signals import LEGS, Command, DriveMode, DriveState, Reaction
from drivers.tick_columns import Record

TRIES = 10
"""Most CONFIG sent to a drive that does not confirm its set-up."""
SETUP_S = 0.02
"""Time from one CONFIG of a drive to its next."""
NOT_HEARD = -1
"""Checksum of a drive whose status has not been received."""
_POWERED = (DriveState.READY, DriveState.RUN)


@pointed(ends, INTEGER, INTEGER, INTEGER)
def fresh(e: Any, frame_address: int, tick: int, since_ns: int) -> int:
    """Leg + 1 of a feedback with valid CRC that answers this tick's SYNC on the leg's bus; else 0."""
    frame = frame_at(frame_address)
    identifier: Any = np.int64(frame.id)
    leg = place_of(identifier, e.feedback)
    good = leg >= 0 and frame.bus == e.home[leg] and not frame.flags & STRANGE
    good = good and frame.length == e.feedback_length and frame.t_ns >= since_ns
    good = good and (tick - np.int64(frame.data[e.counter_at])) & 0xF == 0
    return leg + 1 if good and intact(frame) else 0


@pointed(ends, INTEGER)
def addressed(e: Any, frame_address: int) -> int:
    """Legs that a frame addresses, bit i: leg i. A CONFIG addresses one leg, others all on their bus."""
    frame = frame_at(frame_address)
    identifier: Any = np.int64(frame.id)
    only = identifier if place_of(identifier, e.config) >= 0 else EVERYONE
    return legs_of(only, e.config, frame.bus, e.home)


class LegsController(ControllerEnd):
    """The controller's end of six drives of protocol `legs`. Mutable state: its record."""

    first = "expected"

    def __init__(self, family: Any, setup: DriveSetup) -> None:
        configs, begun = family.configure(setup.watchdog_s, setup.reaction), family.tables.copy()
        self._family, self._configs = family, sent_array(configs)
        begun["expected"] = [set_up_checksum(n, data[:-1], family.rated_force_N) for n, data, _ in configs]
        begun["interval"], begun["said"] = max(LEGS, round(SETUP_S * setup.rate_Hz)), NOT_HEARD
        super().__init__(begun, kernels.decode, kernels.command, family.syncs)

    def set_up(self, tick: Record) -> Rows:
        """CONFIG frame for a drive that answers but has not confirmed its set-up; at most one per tick.

        A drive that has left BOOT gets it at most TRIES times.
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

    def lack(self, leg: int) -> str:
        """Reason, as text, why a drive does not count as set up, by its state and checksum."""
        times, said, expected = (int(self.state[name][leg]) for name in ("sent", "said", "expected"))
        if not times:
            return "it has been sent no CONFIG"
        if int(self.state["confirmed"]) >> leg & 1:
            return ""
        if said in (NOT_HEARD, expected):
            return f"it has not confirmed any of {times} CONFIG frames by a status"
        if said == 0:
            return "it reports no set-up: it has accepted no CONFIG"
        return (
            f"its set-up has checksum 0x{said:04X}, not 0x{expected:04X}: it uses a CONFIG other than the "
            f"one sent, or its rated force is not drives.force_limit_N, {self._family.rated_force_N:g} N"
        )

    def unfit(self, force: Array) -> ProtocolError:
        """Error for leg forces (6,) N beyond the range of the command's fields."""
        of = self._family.commands[0][0]
        return ProtocolError(
            f"force command {force.tolist()} N does not fit layout {self._family.layout}: {of.low[0]:.12g} "
            f"to {of.high[0]:.12g} N are allowed; lower limits.force_N or choose another bus.layout"
        )


MAX_NODE = 127


class LegsProtocol(Family):
    """The protocol `legs` in one layout: `classic`, `fd` or `ideal`. Has constant tables only.

    `node_ids`: the drives' node numbers, leg order, 1..127, all different; `rated_force_N`: 100 per cent of
    the short force fields; `legs`: the legs of each bus. Each bus has a command of its own, with the forces
    of its legs only; CONFIG gives a drive the place of its leg in it. A bus with three legs or fewer has room
    for three. Raises ConfigurationError for other node numbers or a rated force that does not fit.
    """

    fresh_by, addressed_by = fresh, addressed

    def __init__(
        self,
        layout: str,
        node_ids: Sequence[int],
        rated_force_N: float = 60_000.0,
        legs: Sequence[Sequence[int]] = (ALL_LEGS,),
    ) -> None:
        super().__init__(node_ids, legs)
        self.layout, self.rated_force_N = layout, rated_force_N
        self.refuse_nodes(1, MAX_NODE, "legs")
        text, version, m = read_messages(rated_force_N)
        self.database = "legs.dbc", text
        self.sync, self.estop, self.config = m["SYNC"], m["ESTOP"], m["CONFIG_1"]
        self.status, self.feedback = m["STATUS_1"], m[f"FEEDBACK_{layout.upper()}_1"]
        self.commands = tuple([m[name] for name in names] for names in COMMANDS[layout])
        """Messages of a command: the long ones, then the short ones."""
        self.exact = self.feedback.places[0][1] == EXACT
        """True if the quantities are float64."""
        self.tables: Any = np.zeros((), ENDS)
        """Initial record of each end; see `drivers.legs.kernels.ENDS`."""
        commands = {m[name].id: 0 for both in COMMANDS.values() for names in both for name in names}
        self.tables["version"], self.tables["command_ids"] = version, [*commands]
        self._tabulate()
        self.wanted = tuple(self.tables["feedback"].tolist())
        both = self.wanted, self.tables["status"].tolist()
        self.senders = {identifier: leg for ids in both for leg, identifier in enumerate(ids)}
        syncs = [sent_array(self.to_all(self.sync.frame(self.sync.id, cycle))) for cycle in range(256)]
        self.syncs: Rows = np.array(syncs)
        """SYNC of each Cycle on all buses, FRAME records."""

    def _tabulate(self) -> None:
        t, of, force = self.tables, self.feedback, self.commands[0][0]
        for name in ("feedback", "status", "config"):
            t[name] = getattr(self, name).id - 1 + np.array(self.nodes)
        for name in ("feedback", "status", "sync"):
            t[f"{name}_length"] = getattr(self, name).length
        t["feedback_flags"], t["status_flags"] = of.flags, self.status.flags
        t["sync"], t["estop"], t["watchdog_s"] = self.sync.id, self.estop.id, self.config.scale[0]
        t["rated_mN"] = round(self.rated_force_N * 1e3)
        t["place"] = [self.legs[bus].index(leg) + 1 for leg, bus in enumerate(self.bus_of)]
        t["home"], t["buses"], t["present"] = self.bus_of, len(self.legs), NO_SYNC
        start, bits = zip(*of.places, strict=True)
        t["counter_at"] = of.place("Counter")[0] // 8
        n = QUANTITIES if "Force" in of.signals else QUANTITIES - 1
        columns = start, bits, of.scale, of.low, of.high
        for name, values in zip(("start", "bits", "scale", "low", "high"), columns, strict=True):
            t[name][:n] = values[:n]
        steps = 1 << force.places[0][1] - 1
        least, most = (force.low[0], force.high[0]) if self.exact else (-steps, steps - 1)
        t["step"], t["least"], t["most"] = force.scale[0], least, most
        rows = [row for bus, legs in enumerate(self.legs) if legs for row in self._command_rows(bus)]
        self._commands = np.array(rows, COMMAND)
        t["commands"], t["frames"] = data_at(self._commands), len(rows)

    def _command_rows(self, bus: int) -> list[tuple[Any, ...]]:
        rest, rows = [*self.legs[bus]], []
        for of in self.commands[len(rest) <= SHORT]:
            forces = sum(name.startswith("Force") for name in of.signals)
            own, rest = rest[:forces], rest[forces:]
            leg = [*own, *[-1] * LEGS][:LEGS]
            places = [of.place(name) for name in ("Counter", "Mode", "CRC")]
            rows.append((of.id, of.flags, bus, of.length, len(own), forces, *of.places[0], *places, leg))
        return rows

    @cached_property
    def traits(self) -> Traits:
        """Properties of drives of protocol `legs`; fields are rounded, so errors are half a step."""
        of, stop, zeros = self.feedback, self.estop, np.zeros(LEGS)
        end = self.controller_end(DriveSetup(1.0, Reaction.BRAKE, 1000.0))
        sent = *sent_frames(end.begin(0)), *sent_frames(end.give(Command(DriveMode.OFF, zeros), 0))
        length, rate, *_ = (0.0 if self.exact else 0.5 * each for each in of.scale)
        force = 0.0 if self.exact else 0.5 * self.commands[0][0].scale[0]
        return Traits(
            family="legs",
            resolution=Resolution.of(length, rate, force),
            sent=sent,
            feedbacks=self.to_each(Frame(each, bytes(of.length), of.flags) for each in self.wanted),
            emergency_stop=self.to_all(Frame(stop.id, stop.pack(0), stop.flags)),
            feedback_ids=frozenset(self.wanted),
            database=self.database,
            set_up_frames=1,
            reset_ticks=5,
            reactions=tuple(Reaction),
            stop_latches=True,
            force_on_brakes=True,
            answers_name_sync=True,
            latches_together=True,
            reports_force="Force" in of.signals,
        )

    def controller_end(self, setup: DriveSetup) -> LegsController:
        """Compiled controller's end of these drives. Raises ProtocolError if the watchdog does not fit."""
        return LegsController(self, setup)

    # frames

    def configure(self, watchdog_s: float, reaction: Reaction) -> tuple[Frame, ...]:
        """CONFIG frame of each drive. Raises ProtocolError for a watchdog outside 1e-6 .. 4294 s."""
        of, t = self.config, self.tables
        steps = watchdog_s / of.scale[0]
        if not isfinite(steps) or not 1 <= round(steps) < 1 << 32:
            raise ProtocolError(
                f"drives.watchdog_ms: {1e3 * watchdog_s:g} ms does not fit into CONFIG, allowed: "
                "0.001 to 4294967.295 ms"
            )
        each = zip(t["config"].tolist(), t["place"].tolist(), strict=True)
        same = round(steps), int(reaction)
        return self.to_each(of.frame(number, *same, place, int(t["version"])) for number, place in each)


_made = cache(LegsProtocol)
"""Codec for some arguments; equal arguments share one."""


def legs(bus: BusSettings, drives: DriveSettings) -> LegsProtocol:
    """Codec of the configured layout. Raises ConfigurationError for settings that it does not support."""
    if drives.options:
        raise ConfigurationError(
            f"drives.options: protocol legs has no options, given: {', '.join(drives.options)}"
        )
    if drives.transmission is not None:
        raise ConfigurationError(
            "drives.transmission: protocol legs reports leg lengths and forces and has no transmission; "
            "remove this section"
        )
    return _made(bus.layout, tuple(drives.node_ids), drives.force_limit_N, bus.legs)
