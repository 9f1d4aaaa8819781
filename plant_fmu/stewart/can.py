"""Our end of the bus as a CAN FMU (FMI-LS-BUS 1.0): six drives of the protocol `legs` with the platform.

Here are its variables, its bus terminal, and the C header of its messages, generated from legs.dbc.
"""

from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from drivers.legs.crc import POLYNOMIAL, POLYNOMIAL_16
from drivers.legs.messages import COMMANDS, Layout, layouts, read_dbc
from drivers.protocol import FD
from drivers.signals import LEGS, DriveFault, DriveMode, DriveState, Reaction
from plant_fmu.stewart import variables as table
from plant_fmu.stewart.variables import Variable

DESCRIPTION = (
    "Stewart-Gough platform behind six drives of the protocol legs on a CAN bus (FMI-LS-BUS 1.0): "
    "frames in, frames out."
)
BUS_BYTES = 4096
"""Largest size of Rx_Data and Tx_Data."""
_MIME = 'application/org.fmi-standard.fmi-ls-bus.can; version="1.0.0"'
_MEMBERS = ("Rx_Data", "Tx_Data", "Rx_Clock", "Tx_Clock")
"""Members of the terminal, see attached/terminalsAndIcons, in the order of their value references."""
# fmt: off
_ROWS: tuple[tuple[Any, ...], ...] = (
    ("layout", "Layout", (), (2.0,), "Layout of the frames, as bus.layout of the controller"),
    ("node_id", "NodeNumber", (LEGS,), (1.0, 2.0, 3.0, 4.0, 5.0, 6.0), "Node number of each leg's drive"),
    ("bitrate", "BitRate", (), (1e6,), "Bit rate of the arbitration, bit/s"),
    ("data_bitrate", "BitRate", (), (5e6,), "Bit rate of the data phase of CAN FD, bit/s"),
    ("drive_force_limit", "ForceBound", (), (60_000.0,), "Rated force, at which a drive saturates"),
    ("encoder_resolution", "Distance", (), (1e-6,), "Step of the measured leg length; 0: exact"),
    ("heartbeat", "Duration", (), (0.1,), "Period of each drive's status message; 0: none"),
    ("drive_damping", "Damping", (), (20_000.0,), "Damping by a drive that reacts to a fault by `damp`"),
    ("drive_stiffness", "Spring", (), (2e6,), "Stiffness by a drive that reacts by `hold`"),
    ("brake_after", "Duration", (), (1.0,), "Time from the fault to the brake, after damping or holding"),
    ("brake_opening_time", "Duration", (), (0.0,), "Time in which a brake opens"),
    ("brake_closing_time", "Duration", (), (0.0,), "Time in which a brake closes"),
)
# fmt: on


def can_rows(values: Mapping[str, Any]) -> tuple[Variable, ...]:
    """Variables of the CAN FMU; values: start values of parameters by name, flat, SI.

    The drives compute `force` and `brake`, so that these are outputs.
    """
    rows: list[Variable] = []
    for row in table.VARIABLES:
        if row.name == "force":
            rows += [Variable(*each)._replace(causality="parameter") for each in _ROWS]
        drives = row.name in {"force", "brake"}
        rows.append(row._replace(causality="output", start=None) if drives else row)
    return tuple(_started(row, values[row.name]) if row.name in values else row for row in rows)


def _started(row: Variable, value: Any) -> Variable:
    items = table.TYPES[row.type].items
    given = items.index(value) + 1 if items else value
    return row._replace(start=tuple(np.ravel(given).astype(float).tolist()))


def bus_variables(parent: ET.Element, first: int) -> str:
    """Add the variables of the terminal from value reference `first` on; returns that of Tx_Data."""
    data = {"variability": "discrete", "maxSize": str(BUS_BYTES), "mimeType": _MIME}
    refs = {member: str(first + k) for k, member in enumerate(_MEMBERS)}
    for member, ref in refs.items():
        about = {"name": f"CAN.{member}", "valueReference": ref, "causality": "input"}
        if member.endswith("Clock"):
            kind = "triggered" if member == "Rx_Clock" else "countdown"
            ET.SubElement(parent, "Clock", {**about, "intervalVariability": kind})
            continue
        about["clocks"] = refs[member.replace("Data", "Clock")]
        if member == "Rx_Data":
            ET.SubElement(ET.SubElement(parent, "Binary", {**about, **data}), "Start", value="")
        else:
            ET.SubElement(parent, "Binary", {**about, **data, "causality": "output"})
    return refs["Tx_Data"]


def _names(prefix: str, of: type[IntEnum]) -> str:
    return f"enum {{ {', '.join(f'{prefix}_{each.name} = {each.value}' for each in of)} }};"


def legs_header() -> str:
    """Text of the generated C header legs.h: messages of legs.dbc, names of states, modes and reactions."""
    text = read_dbc("drivers.legs", "legs.dbc")
    messages, doubled = layouts(text, 100.0), layouts(text, 200.0)
    commands = [[messages[name] for name in (*long, *long)[:2]] for long, _ in COMMANDS.values()]
    feedbacks = [messages[f"FEEDBACK_{layout.upper()}_1"] for layout in COMMANDS]
    used = {name: messages[name] for name in ("SYNC", "ESTOP", "CONFIG_1", "STATUS_1")}
    every = [*used.values(), *feedbacks, *(message for each in commands for message in each)]
    signals = sorted({signal.upper() for message in every for signal in message.signals})
    of_rated = {id(messages[name]): doubled[name].scale for name in messages}

    def row(message: Layout) -> str:
        columns = message.signals, message.places, message.scale, message.low, message.high
        fields = (
            f"[{name.upper()}] = {{{start}, {bits}, {int(scale != twice)}, {scale!r}, {low!r}, {high!r}}}"
            for name, (start, bits), scale, low, high, twice in zip(
                *columns, of_rated[id(message)], strict=True
            )
        )
        head = f"{message.id}, {message.length}, {int(message.flags != 0)}, {int(message.flags > FD)}"
        return f"{{{head}, {{{', '.join(fields)}}}}}"

    def rows(of: Iterable[Layout]) -> str:
        return f"{{{', '.join(map(row, of))}}}"

    lines = [f"static const Message {name.removesuffix('_1')} = {row(m)};" for name, m in used.items()]
    return f"""/* Generated from legs.dbc. A field: first bit, bits (0: missing), scale and range; they are in
 * % of the rated force if of_rated. Messages of nodes are those of node 1. COMMAND: both frames of
 * a layout, or its one frame twice. */
#ifndef STEWART_LEGS_H
#define STEWART_LEGS_H

#define LEGS_VERSION {int(text.removeprefix('VERSION "').partition(".")[0])}
#define POLYNOMIAL {POLYNOMIAL:#x}
#define POLYNOMIAL_16 {POLYNOMIAL_16:#x}
enum {{ {", ".join(signals)}, SIGNALS }};
{_names("STATE", DriveState)}
{_names("MODE", DriveMode)}
{_names("FAULT", DriveFault)}
{_names("REACTION", Reaction)}

typedef struct {{
    int start, bits, of_rated;
    double scale, low, high;
}} Field;

typedef struct {{
    unsigned id;
    int length, fd, brs;
    Field of[SIGNALS];
}} Message;

{chr(10).join(lines)}
static const Message FEEDBACK[3] = {rows(feedbacks)};
static const Message COMMAND[3][2] = {{{", ".join(map(rows, commands))}}};

#endif
"""
