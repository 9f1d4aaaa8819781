"""The drives' end of CiA 402 in Python: NMT, SDO and rejected frames of six emulated drives.

The drives follow the standards, not our controller: CiA 301 for communication, IEC 61800-7-201 for the drive.
`cia402_dictionary` lists the objects that they have. Each drive controls its brake. Quick stop and NMT stop
engage the brake at once, as the emulated power stage has no ramps.
"""

from typing import Any

import numpy as np

from drivers.cia402 import objects as o
from drivers.cia402.objects import Key
from drivers.cia402.states import CODES, DISABLED, ENABLED, QUICK_STOP, STATUSWORDS
from drivers.compiled.pointed import data_at
from drivers.protocol import BUS, Frame
from drivers.signals import LEGS, DriveFault, DriveMode, Reaction
from plant_fmu.drives import cia402_dictionary as dictionary
from plant_fmu.drives import cia402_kernels as kernels
from plant_fmu.drives.codec import CONFIGURE, REJECTED, STOP, UNWATCHED, DrivesEnd

NO_WATCHDOG_NS = 10**15
"""Watchdog time of a drive without a consumer heartbeat time."""
_SHORT_PDO = bytes.fromhex("1082010000000000")
_NODE = 0x7F


class Cia402Drives(DrivesEnd):
    """The drives' end of six CiA 402 drives. Mutable state: six DEVICE records."""

    def __init__(self, family: Any) -> None:
        d: Any = np.zeros((), kernels.DEVICES)
        super().__init__(d, kernels.parse, kernels.answer, kernels.report)
        for name in ("nodes", "N_per_permille", "buses", "bus_of"):
            d[name] = family.tables[name]
        family.transmission.fill(d)
        d["rated_mNm"], d["codes"] = family.rated_torque_mNm, [CODES.get(fault, 0) for fault in DriveFault]
        self.nodes, self._bus_of = d["nodes"].tolist(), d["bus_of"].tolist()
        self._new = np.zeros(LEGS, kernels.DEVICE)
        for row, node, counts in zip(self._new, self.nodes, d["counts"].tolist(), strict=True):
            row["values"] = dictionary.defaults(node, family.rated_torque_mNm, round(counts))
            dictionary.fill_pdos(row)
        self.state = self._new.copy()
        self.record["devices"], self.record["new"] = data_at(self.state), data_at(self._new)

    def converse(self, frame: Frame) -> None:
        """Process an NMT command, an SDO request, or a frame to reject.

        Rejected: a PDO that is shorter than its mapping, an NMT or heartbeat frame of a wrong length, an SDO
        request whose length is not 8.
        """
        identifier, data, _ = frame
        here = [leg for leg in range(LEGS) if self._bus_of[leg] == frame.bus]
        if identifier == o.NMT_ID:
            if len(data) != 2:
                self.put(REJECTED)
                return
            for leg in here:
                if data[1] in (0, self.nodes[leg]):
                    self._on_nmt(leg, data[0])
            return
        cut = [
            leg
            for leg in np.argwhere(self.state["pdos"][:, 0] == identifier)[:, 0].tolist()
            if leg in here and self.state["nmt"][leg] == o.OPERATES
        ]
        for leg in cut:
            self.put(REJECTED)
            self._send(leg, o.EMCY_ID, _SHORT_PDO)
        if cut:
            return
        if identifier & ~_NODE == o.HEARTBEAT_ID or len(data) != 8:
            self.put(REJECTED)
            return
        leg = self.nodes.index(identifier & _NODE)
        if leg in here:
            self._on_sdo(leg, data)

    def _send(self, leg: int, base: int, data: bytes) -> None:
        self.say(leg, Frame(base + self.nodes[leg], data, BUS * self._bus_of[leg]))

    def _on_nmt(self, leg: int, command: int) -> None:
        d = self.state[leg]
        if d["nmt"] == o.BOOTS:
            return
        if command == o.START:
            d["nmt"], d["started"] = o.OPERATES, True
            self._configure(leg)
        if command == o.PRE_OPERATIONAL:
            d["nmt"] = o.PREPARES
        if command == o.STOP:
            d["nmt"] = o.STOPPED
            if d["state"] == ENABLED:
                d["state"] = QUICK_STOP
                self.put(STOP, (leg,))
        if command in (o.RESET_NODE, o.RESET_COMMUNICATION):
            commands = int(d["commands"]) + 1
            self.state[leg] = self._new[leg]
            d["commands"], d["nmt"], d["state"] = commands, o.PREPARES, DISABLED
            self.put(UNWATCHED, (leg,), DriveMode.OFF, commands)
            self._send(leg, o.HEARTBEAT_ID, bytes((o.BOOTS,)))

    def _configure(self, leg: int) -> None:
        values = self.state["values"][leg]
        time_ms = int(values[dictionary.PLACE[o.CONSUMER_HEARTBEAT]]) & 0xFFFF
        at_once = values[dictionary.PLACE[o.FAULT_REACTION]] == 0
        watchdog_ns = 1_000_000 * time_ms if time_ms else NO_WATCHDOG_NS
        self.put(CONFIGURE, (leg,), Reaction.BRAKE if at_once else Reaction.DAMP, watchdog_ns)

    def _on_sdo(self, leg: int, data: bytes) -> None:
        """Answer an SDO request; segmented and block transfers are refused, as no object needs them."""
        d, specifier, key = self.state[leg], data[0], (data[1] | data[2] << 8, data[3])
        kind = specifier >> 5
        if d["nmt"] in (o.BOOTS, o.STOPPED) or kind == 4:
            return
        code, answer = dictionary.missing(key) if kind in (1, 2) else o.BAD_COMMAND, b""
        if not code and kind == 2:
            d["values"][dictionary.PLACE[o.STATUSWORD]] = STATUSWORDS[d["state"]]
            size = dictionary.ENTRIES[key].size
            value = int(d["values"][dictionary.PLACE[key]]) & (1 << 8 * size) - 1
            answer = o.head(0x43 | 4 - size << 2, key) + value.to_bytes(4, "little")
        elif not code:
            code = self._write(leg, key, specifier, data[4:])
            answer = o.head(0x60, key) + bytes(4)
        self._send(leg, o.SDO_REPLY_ID, o.abort(key, code) if code else answer)

    def _write(self, leg: int, key: Key, specifier: int, data: bytes) -> int:
        """Execute an SDO download (write); returns the abort code, 0 for success."""
        if not specifier & 2:
            return o.TOO_LONG
        d, said = self.state[leg], 4 - (specifier >> 2 & 3) if specifier & 1 else 0
        value = int.from_bytes(data[: said or dictionary.ENTRIES[key].size], "little")
        code = dictionary.refused(d["values"], key, value, said)
        if code:
            return code
        if key == o.CONTROLWORD:
            self._count += kernels.control(self.record, leg, value, data_at(self.messages[self._count :]))
            return 0
        d["values"][dictionary.PLACE[key]] = dictionary.signed(key, value)
        if key == o.MODE:  # active at once, and displayed
            d["values"][dictionary.PLACE[o.MODE_SHOWN]] = d["values"][dictionary.PLACE[key]]
        if o.RPDO <= key[0] < o.TPDO_MAP + dictionary.PDOS:
            dictionary.fill_pdos(d)
        if key in (o.CONSUMER_HEARTBEAT, o.FAULT_REACTION) and d["started"]:
            self._configure(leg)
        return 0
