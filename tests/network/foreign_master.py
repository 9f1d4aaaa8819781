"""A controller of another tool at our CAN FMU: fmpy's low-level calls, cantools and struct, nothing of ours."""

import ctypes
import struct
import zipfile
from typing import Any

import cantools
import fmpy
from crccheck.crc import Crc8SaeJ1850, Crc16M17  # type: ignore[import-untyped]
from fmpy.fmi3 import FMU3Slave

OFF, READY, RUN = 0, 1, 2


class ForeignMaster:
    """Steps the FMU, exchanges frames at its countdown clock; `seen`: last signals by message name."""

    def __init__(self, fmu, folder, dbc):
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(folder)
        xml = fmpy.read_model_description(str(folder))
        self.ref = {each.name: each.valueReference for each in xml.modelVariables}
        self.dbc: Any = cantools.database.load_file(dbc)
        self.now, self.seen = 0.0, {}
        self.due: float | None = 0.0
        about = {"guid": xml.guid, "modelIdentifier": xml.coSimulation.modelIdentifier}
        self.fmu = FMU3Slave(unzipDirectory=str(folder), **about)
        self.fmu.instantiate(eventModeUsed=True)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        self.event()
        self.fmu.enterStepMode()

    def event(self, sent=b""):
        """Event mode at `now`: give it operations, take what it sends until it sends nothing more."""
        tx, interval, qualifier = self.ref["CAN.Tx_Clock"], (ctypes.c_double * 1)(), (ctypes.c_int * 1)()
        while sent or (self.due is not None and self.due <= self.now + 1e-10):
            if sent:
                self.fmu.setClock([self.ref["CAN.Rx_Clock"]], [True])
                self.fmu.setBinary([self.ref["CAN.Rx_Data"]], [sent])
            else:
                self.fmu.setClock([tx], [True])
                self.take(self.fmu.getBinary([self.ref["CAN.Tx_Data"]])[0])
            sent = b""
            assert not self.fmu.updateDiscreteStates()[0]
            self.fmu.getIntervalDecimal((ctypes.c_uint32 * 1)(tx), interval, qualifier)
            self.due = self.now + interval[0] if qualifier[0] == 2 else None

    def take(self, binary):
        while binary:
            code, length = struct.unpack_from("<II", binary)
            if code in (0x10, 0x11):  # CAN Transmit, CAN FD Transmit
                (identifier,), data = struct.unpack_from("<I", binary, 8), binary[16 + code % 16 : length]
                message = self.dbc.get_message_by_frame_id(identifier)
                self.seen[message.name] = message.decode(data, decode_choices=False)
                assert self.sealed(message, data) == data
            binary = binary[length:]

    def sealed(self, message, data):
        width, lead = (2, Crc16M17) if message.name == "COMMAND_FD" else (1, Crc8SaeJ1850)
        at = message.get_signal_by_name("CRC").start // 8
        check = lead.calc(struct.pack("<H", message.frame_id) + data[:at]).to_bytes(width, "little")
        return data[:at] + check + data[at + width :]

    def send(self, name, **signals):
        message = self.dbc.get_message_by_name(name)
        data = self.sealed(message, message.encode({"CRC": 0, **signals}, strict=False))
        code, switches = (0x11, b"\0\1\0") if len(data) > 8 else (0x10, b"\0\0")
        head = struct.pack("<III", code, 14 + len(switches) + len(data), message.frame_id)
        self.event(head + switches + struct.pack("<H", len(data)) + data)

    def step(self, until):
        while self.now < until - 1e-10:
            to = until if self.due is None else min(until, max(self.due, self.now))
            self.fmu.doStep(self.now, to - self.now)
            self.now = to
            self.fmu.enterEventMode()
            self.event()
            self.fmu.enterStepMode()
