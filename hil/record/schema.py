"""Protobuf messages of the log: frames, operator commands, and the building blocks of any schema."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

from hil.signals import Operator

LIBRARY = "hexapod-hil"
IDENTITY, ENVIRONMENT, SUMMARY, SALVAGE = "hil", "environment", "summary", "salvage"
"""Names of the metadata records."""
RUN = "run"
"""Key in IDENTITY: an identifier that only the two logs of one simulation share."""
CLEAN, PRODUCER_DIED, DISK_FULL = "clean", "producer died", "disk_full"
"""Values of the key `closed` in SUMMARY: how a log was closed."""
SPAN, PEAK_ERROR = "duration_s", "peak_leg_error_mm"
"""Keys in SUMMARY: time from first to last row; largest error of a leg in TRACKING."""
CONFIGURATION = "config.yaml"
"""Name of the attachment that holds the configuration."""

CAN_TOPIC, OPERATOR_TOPIC, EVENTS_TOPIC = "/can", "/operator", "/events"
LEVELS = {"debug": 1, "info": 2, "warning": 3, "error": 4}
"""Levels of events, as foxglove.Log counts them."""
LEVEL_NAMES = {number: name for name, number in LEVELS.items()}
PACKAGE = "hil"
FRAME = "hil.Frame"
OPERATOR = "hil.OperatorCommand"
RX, TX = 1, 2
"""Values of hil.Frame.direction."""

_STAMPED = "received: end of the frame; sent: the tick, or the send"

Type = descriptor_pb2.FieldDescriptorProto


class Schema(NamedTuple):
    """Protobuf message type: its full name and a serialised FileDescriptorSet with all dependencies."""

    name: str
    descriptors: bytes


def frame_schema() -> Schema:
    """Protobuf schema of hil.Frame, a CAN frame with the names of can_msgs/Frame, and more for CAN FD."""
    file = new_file(FRAME)
    header = file.message_type.add(name="Header")
    add_field(header, "stamp", 1, Type.TYPE_MESSAGE, type_name=".google.protobuf.Timestamp")
    direction = file.enum_type.add(name="Direction")
    for value, text in enumerate(("UNKNOWN_DIRECTION", "RX", "TX")):
        direction.value.add(name=text, number=value)
    file.dependency.append(timestamp_pb2.DESCRIPTOR.name)
    message = file.message_type[0]
    fields: list[tuple[str, Type.Type.ValueType, str, str]] = [
        ("header", Type.TYPE_MESSAGE, ".hil.Header", _STAMPED),
        ("id", Type.TYPE_FIXED32, "", "without flags"),
        ("is_rtr", Type.TYPE_BOOL, "", ""),
        ("is_extended", Type.TYPE_BOOL, "", ""),
        ("is_error", Type.TYPE_BOOL, "", ""),
        ("dlc", Type.TYPE_UINT32, "", "code of ISO 11898-1: 9 is 12 bytes, 15 is 64"),
        ("data", Type.TYPE_BYTES, "", ""),
        ("channel", Type.TYPE_STRING, "", ""),
        ("direction", Type.TYPE_ENUM, ".hil.Direction", "seen from who wrote the log"),
        ("fdf", Type.TYPE_BOOL, "", "CAN FD format"),
        ("brs", Type.TYPE_BOOL, "", "bit rate switch"),
        ("esi", Type.TYPE_BOOL, "", "error state indicator"),
        ("tick", Type.TYPE_SFIXED64, "", "tick that consumed or sent the frame"),
        ("index", Type.TYPE_FIXED32, "", "order within the tick"),
        ("bus", Type.TYPE_UINT32, "", "which of the buses, from 0"),
    ]
    for number, (name, kind, type_name, text) in enumerate(fields, start=1):
        add_field(message, name, number, kind, type_name=type_name)
        if text:
            comment(file, number - 1, text)
    return schema_of(FRAME, [*files(timestamp_pb2.DESCRIPTOR), file])


def operator_schema() -> Schema:
    """Protobuf schema of hil.OperatorCommand, a recorded operator command."""
    file = new_file(OPERATOR)
    file.dependency.append(timestamp_pb2.DESCRIPTOR.name)
    kinds = file.enum_type.add(name="Operator")
    kinds.value.add(name="UNKNOWN_OPERATOR", number=0)
    for command in Operator:
        kinds.value.add(name=command.name, number=command.value)
    message = file.message_type[0]
    add_field(message, "stamp", 1, Type.TYPE_MESSAGE, type_name=".google.protobuf.Timestamp")
    add_field(message, "command", 2, Type.TYPE_ENUM, type_name=".hil.Operator")
    add_field(message, "tick", 3, Type.TYPE_SFIXED64)
    add_field(message, "index", 4, Type.TYPE_FIXED32)
    add_field(message, "setpoint", 5, Type.TYPE_DOUBLE, repeated=True)
    comment(file, 4, "of SETPOINT: x, y, z in m and the rotation vector in rad; else the command's numbers")
    return schema_of(OPERATOR, [*files(timestamp_pb2.DESCRIPTOR), file])


def message_class(schema: Schema) -> Any:
    """Python class of a protobuf message type, built from the descriptors in its schema."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.descriptors).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))


def new_file(name: str) -> descriptor_pb2.FileDescriptorProto:
    """Protobuf file descriptor with one message, `name` with its package, that has no fields yet."""
    package, _, message = name.rpartition(".")
    file = descriptor_pb2.FileDescriptorProto(
        name=f"{package}/{message}.proto", package=package, syntax="proto3"
    )
    file.message_type.add(name=message)
    return file


def add_field(
    message: descriptor_pb2.DescriptorProto,
    name: str,
    number: int,
    kind: Type.Type.ValueType,
    *,
    type_name: str = "",
    repeated: bool = False,
) -> None:
    """Add a field to the descriptor of a protobuf message."""
    label = Type.LABEL_REPEATED if repeated else Type.LABEL_OPTIONAL
    field = message.field.add(name=name, number=number, type=kind, label=label)
    if type_name:
        field.type_name = type_name


def comment(file: descriptor_pb2.FileDescriptorProto, index: int, text: str) -> None:
    """Attach a comment to field `index`, from 0, of the first message in a protobuf file descriptor."""
    file.source_code_info.location.add(
        path=[4, 0, 2, index], span=[index + 1, 0, 0], leading_comments=f" {text}\n"
    )


def files(file: Any) -> list[descriptor_pb2.FileDescriptorProto]:
    """File descriptors of a file and of its dependencies, each once, dependencies first."""
    found: list[descriptor_pb2.FileDescriptorProto] = []
    for needed in file.dependencies:
        found += [each for each in files(needed) if each not in found]
    proto = descriptor_pb2.FileDescriptorProto()
    file.CopyToProto(proto)
    return [*found, proto]


def schema_of(name: str, files: Sequence[descriptor_pb2.FileDescriptorProto]) -> Schema:
    """Schema of the message with the full name `name`, which is defined in the last of the files."""
    return Schema(name, descriptor_pb2.FileDescriptorSet(file=files).SerializeToString(deterministic=True))
