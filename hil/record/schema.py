"""The messages of the log in protobuf, and their wire layout as NumPy structured types.

Descriptions only, no files, no processes. Every field of our own messages has a fixed size on the wire
(fixed64, fixed32, double, one-byte varints, varints padded to five bytes), so that a batch of messages is one
structured array: written and read with one NumPy copy per column. Any protobuf parser reads them;
`hil.record.log` checks the layout of what it reads and falls back to one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from math import prod
from typing import Any, NamedTuple

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from numpy.typing import NDArray

from drivers.arrays import Bytes, Ints, Rows
from hil.signals import Operator

LIBRARY = "hexapod-hil"
FORMAT = "1"
"""Version of the log's format."""
IDENTITY, ENVIRONMENT, SUMMARY, SALVAGE = "hil", "environment", "summary", "salvage"
"""Names of the metadata records."""
CONFIGURATION = "config.yaml"
"""Name of the attachment that holds the configuration."""

PACKAGE = "hil"
FRAME = "hil.Frame"
OPERATOR = "hil.OperatorCommand"
RX, TX = 1, 2
"""hil.Frame.direction."""

RECORD_HEADER = 31
"""Bytes of an MCAP Message record in front of its data."""
MAX_DATA = 64
_DLC_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
_SHIFTS = np.array([0, 7, 14, 21, 28], np.int64)
_MORE = np.array([0x80, 0x80, 0x80, 0x80, 0], np.uint8)
_FIXED64, _LENGTH, _FIXED32, _VARINT = 1, 2, 5, 0
_Type = descriptor_pb2.FieldDescriptorProto

ROW_UNITS: dict[str, str] = {
    "t_ns": "ns",
    "lateness_ns": "ns",
    "compute_ns": "ns",
    "age": "ticks",
    "q": "m",
    "dq": "m/s",
    "drive_force": "N",
    "p": "m",
    "R": "1, row-major, x_base = p + R x_platform",
    "twist": "m/s, rad/s",
    "fk_residual": "m",
    "p_d": "m",
    "R_d": "1, row-major",
    "twist_d": "m/s, rad/s",
    "dtwist_d": "m/s^2, rad/s^2",
    "q_d": "m",
    "dq_d": "m/s",
    "ddq_d": "m/s^2",
    "tau_law": "N",
    "tau": "N",
    "wrench": "N, N m, on the platform at its origin, base frame",
    "reference_time_s": "s",
    "innovation_q": "m, measured less predicted",
    "innovation_tracker": "m, rad, measured less predicted",
    "pose_std": "m, rad, of the fused pose, base frame",
    "wrench_sensor": "N, N m, base frame, on the platform at its origin",
    "lyapunov": "(m/s^2)^2, V of the law's error dynamics over all axes",
    "lyapunov_rate": "(m/s^2)^2/s, of V since the last tick",
    "lyapunov_bound": "(m/s^2)^2, the largest V that its certificate allows",
    "lyapunov_share": "1, largest sqrt(V) of an axis over what is allowed",
}
"""Units of the columns of hil.signals.ROW; columns not listed are counts, flags or enumerations."""


class Schema(NamedTuple):
    """A protobuf message type: its full name and a serialised FileDescriptorSet with all it needs."""

    name: str
    descriptors: bytes


class Layout(NamedTuple):
    """Constant wire layout of one message type, with the header of its MCAP Message record in front."""

    template: Bytes
    """(size,) all constant bytes in place."""
    record: np.dtype[np.void]
    """Fields `@channel @sequence @log_time @publish_time` and the message's own."""
    payload: np.dtype[np.void]
    """The message's own fields, without the record header."""
    constant: NDArray[np.intp]
    """Positions in the payload that are the same in every message."""

    def new(self, count: int) -> Rows:
        """Return `count` records, constants filled in."""
        block = np.empty((count, self.template.size), np.uint8)
        block[:] = self.template
        return block.view(self.record).reshape(count)

    def fits(self, payloads: Bytes) -> bool:
        """Return whether all payloads (n, size) have exactly this layout."""
        if payloads.shape[1] != self.payload.itemsize:
            return False
        expected = self.template[RECORD_HEADER:][self.constant]
        return bool((payloads[:, self.constant] == expected).all())


class _Builder:
    """Collects constant bytes and fields of one message."""

    def __init__(self) -> None:
        self.template = bytearray()
        self.constant: list[int] = []
        self.names: list[str] = []
        self.formats: list[Any] = []
        self.offsets: list[int] = []

    def bytes(self, data: bytes) -> None:
        self.constant.extend(range(len(self.template), len(self.template) + len(data)))
        self.template += data

    def field(self, name: str, kind: Any) -> None:
        self.names.append(name)
        self.formats.append(kind)
        self.offsets.append(len(self.template))
        self.template += bytes(np.dtype(kind).itemsize)

    def tag(self, number: int, wire_type: int) -> None:
        self.bytes(_varint(number << 3 | wire_type))

    def layout(self) -> Layout:
        size = len(self.template)
        header = _MESSAGE_HEADER_FIELDS
        names = [*header, *self.names]
        formats = [*(kind for kind, _ in header.values()), *self.formats]
        offsets = [*(offset for _, offset in header.values()), *(RECORD_HEADER + o for o in self.offsets)]
        opcode_and_length = b"\x05" + (RECORD_HEADER - 9 + size).to_bytes(8, "little")
        template = np.frombuffer(
            opcode_and_length + bytes(RECORD_HEADER - 9) + bytes(self.template), np.uint8
        )
        return Layout(
            template,
            np.dtype(
                {"names": names, "formats": formats, "offsets": offsets, "itemsize": RECORD_HEADER + size}
            ),
            np.dtype(
                {"names": self.names, "formats": self.formats, "offsets": self.offsets, "itemsize": size}
            ),
            np.array(self.constant, np.intp),
        )


_MESSAGE_HEADER_FIELDS: dict[str, tuple[str, int]] = {
    "@channel": ("<u2", 9),
    "@sequence": ("<u4", 11),
    "@log_time": ("<u8", 15),
    "@publish_time": ("<u8", 23),
}


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def pack_varint5(values: Ints) -> Bytes:
    """Encode values below 2^35 as varints padded to five bytes: (n,) -> (n, 5)."""
    return (values[:, None] >> _SHIFTS & 0x7F).astype(np.uint8) | _MORE


def unpack_varint5(encoded: Bytes) -> Ints:
    """Decode five-byte varints: (n, 5) -> (n,)."""
    values: Ints = ((encoded & 0x7F).astype(np.int64) << _SHIFTS).sum(axis=1)
    return values


def data_length_code(length: int) -> int:
    """Return the DLC of ISO 11898-1 for a data field of `length` bytes."""
    return next(code for code, size in enumerate(_DLC_LENGTHS) if size >= length)


def describe_row_type(dtype: np.dtype[np.void]) -> list[list[Any]]:
    """Return `[[name, kind, shape], ...]`, which JSON can carry."""
    return [[name, dtype[name].base.str, list(dtype[name].shape)] for name in dtype.names or ()]


def row_type(description: list[list[Any]]) -> np.dtype[np.void]:
    """Return the row type that `describe_row_type` described."""
    return np.dtype(
        [(name, kind, tuple(shape)) if shape else (name, kind) for name, kind, shape in description]
    )


def check_row_type(dtype: np.dtype[np.void]) -> None:
    """Refuse a row type that has not the constant layout.

    Raises
    ------
    ValueError
        A column is not i8 or f8, or there is no scalar i8 column `tick` or `t_ns`.

    """
    names = dtype.names or ()
    for name in names:
        base, _ = _column(dtype, name)
        if base.str not in {"<i8", "<f8"}:
            raise ValueError(f"column {name} of the row is {base.str}: allowed are <i8 and <f8")
    for name in ("tick", "t_ns"):
        if name not in names or dtype[name] != np.dtype("<i8"):
            raise ValueError(f"the row needs a scalar <i8 column {name}")


def _column(dtype: np.dtype[np.void], name: str) -> tuple[np.dtype[Any], int]:
    """Return element type and number of elements (0: a scalar) of one column."""
    column = dtype[name]
    return (column.base, prod(column.shape)) if column.shape else (column, 0)


def row_layout(dtype: np.dtype[np.void]) -> Layout:
    """Return the wire layout of a row: i8 as sfixed64, f8 as double, arrays packed."""
    check_row_type(dtype)
    builder = _Builder()
    for number, name in enumerate(dtype.names or (), start=1):
        base, count = _column(dtype, name)
        if count:
            builder.tag(number, _LENGTH)
            builder.bytes(_varint(8 * count))
            builder.field(name, (base.str, (count,)))
        else:
            builder.tag(number, _FIXED64)
            builder.field(name, base.str)
    return builder.layout()


@cache
def frame_layout(length: int, channel: bytes) -> Layout:
    """Return the wire layout of hil.Frame with `length` data bytes on the bus named `channel`."""
    builder = _Builder()
    builder.bytes(b"\x0a\x0e\x0a\x0c\x08")
    builder.field("seconds", ("u1", (5,)))
    builder.bytes(b"\x10")
    builder.field("nanos", ("u1", (5,)))
    builder.tag(2, _FIXED32)
    builder.field("id", "<u4")
    for name, number in {"is_rtr": 3, "is_extended": 4, "is_error": 5, "dlc": 6}.items():
        builder.tag(number, _VARINT)
        builder.field(name, "u1")
    builder.tag(7, _LENGTH)
    builder.bytes(_varint(length))
    if length:
        builder.field("data", ("u1", (length,)))
    builder.tag(8, _LENGTH)
    builder.bytes(_varint(len(channel)) + channel)
    for name, number in {"direction": 9, "fdf": 10, "brs": 11, "esi": 12}.items():
        builder.tag(number, _VARINT)
        builder.field(name, "u1")
    builder.tag(13, _FIXED64)
    builder.field("tick", "<i8")
    builder.tag(14, _FIXED32)
    builder.field("index", "<u4")
    return builder.layout()


def row_schema(name: str, dtype: np.dtype[np.void], units: Mapping[str, str]) -> Schema:
    """Return the protobuf type of a row; units stand in the fields' comments."""
    file = _file(name)
    message = file.message_type[0]
    for number, column in enumerate(dtype.names or (), start=1):
        base, count = _column(dtype, column)
        kind = _Type.TYPE_DOUBLE if base.kind == "f" else _Type.TYPE_SFIXED64
        _field(message, column, number, kind, repeated=bool(count))
        if column in units:
            _comment(file, number - 1, f" [{units[column]}]\n")
    return _schema(name, [file])


def frame_schema() -> Schema:
    """Return hil.Frame, its fields named as in can_msgs/Frame, and what CAN FD and replay need."""
    file = _file(FRAME)
    header = file.message_type.add(name="Header")
    _field(header, "stamp", 1, _Type.TYPE_MESSAGE, type_name=".google.protobuf.Timestamp")
    direction = file.enum_type.add(name="Direction")
    for value, text in enumerate(("UNKNOWN_DIRECTION", "RX", "TX")):
        direction.value.add(name=text, number=value)
    file.dependency.append(timestamp_pb2.DESCRIPTOR.name)
    message = file.message_type[0]
    fields: list[tuple[str, _Type.Type.ValueType, str, str]] = [
        (
            "header",
            _Type.TYPE_MESSAGE,
            ".hil.Header",
            "received: end of the frame; sent: the tick, or the send",
        ),
        ("id", _Type.TYPE_FIXED32, "", "without flags"),
        ("is_rtr", _Type.TYPE_BOOL, "", ""),
        ("is_extended", _Type.TYPE_BOOL, "", ""),
        ("is_error", _Type.TYPE_BOOL, "", ""),
        ("dlc", _Type.TYPE_UINT32, "", "code of ISO 11898-1: 9 is 12 bytes, 15 is 64"),
        ("data", _Type.TYPE_BYTES, "", ""),
        ("channel", _Type.TYPE_STRING, "", ""),
        ("direction", _Type.TYPE_ENUM, ".hil.Direction", "seen from who wrote the log"),
        ("fdf", _Type.TYPE_BOOL, "", "CAN FD format"),
        ("brs", _Type.TYPE_BOOL, "", "bit rate switch"),
        ("esi", _Type.TYPE_BOOL, "", "error state indicator"),
        ("tick", _Type.TYPE_SFIXED64, "", "tick that consumed or sent the frame"),
        ("index", _Type.TYPE_FIXED32, "", "order within the tick"),
    ]
    for number, (name, kind, type_name, comment) in enumerate(fields, start=1):
        _field(message, name, number, kind, type_name=type_name)
        if comment:
            _comment(file, number - 1, f" {comment}\n")
    return _schema(FRAME, [_timestamp(), file])


def operator_schema() -> Schema:
    """Return hil.OperatorCommand."""
    file = _file(OPERATOR)
    file.dependency.append(timestamp_pb2.DESCRIPTOR.name)
    kinds = file.enum_type.add(name="Operator")
    kinds.value.add(name="UNKNOWN_OPERATOR", number=0)
    for command in Operator:
        kinds.value.add(name=command.name, number=command.value)
    message = file.message_type[0]
    _field(message, "stamp", 1, _Type.TYPE_MESSAGE, type_name=".google.protobuf.Timestamp")
    _field(message, "command", 2, _Type.TYPE_ENUM, type_name=".hil.Operator")
    _field(message, "tick", 3, _Type.TYPE_SFIXED64)
    _field(message, "index", 4, _Type.TYPE_FIXED32)
    _field(message, "setpoint", 5, _Type.TYPE_DOUBLE, repeated=True)
    _comment(file, 4, " x, y, z in m and the rotation vector in rad, of SETPOINT\n")
    return _schema(OPERATOR, [_timestamp(), file])


def message_class(schema: Schema) -> Any:
    """Return the message class of a schema, from its own descriptors."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.descriptors).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))


def _file(name: str) -> descriptor_pb2.FileDescriptorProto:
    package, _, message = name.rpartition(".")
    file = descriptor_pb2.FileDescriptorProto(
        name=f"{package}/{message}.proto", package=package, syntax="proto3"
    )
    file.message_type.add(name=message)
    return file


def _field(
    message: descriptor_pb2.DescriptorProto,
    name: str,
    number: int,
    kind: _Type.Type.ValueType,
    *,
    type_name: str = "",
    repeated: bool = False,
) -> None:
    label = _Type.LABEL_REPEATED if repeated else _Type.LABEL_OPTIONAL
    field = message.field.add(name=name, number=number, type=kind, label=label)
    if type_name:
        field.type_name = type_name


def _comment(file: descriptor_pb2.FileDescriptorProto, index: int, text: str) -> None:
    """Attach a comment to field `index` of the file's first message."""
    file.source_code_info.location.add(path=[4, 0, 2, index], span=[index + 1, 0, 0], leading_comments=text)


def _timestamp() -> descriptor_pb2.FileDescriptorProto:
    file = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(file)
    return file


def _schema(name: str, files: Sequence[descriptor_pb2.FileDescriptorProto]) -> Schema:
    return Schema(name, descriptor_pb2.FileDescriptorSet(file=files).SerializeToString(deterministic=True))
