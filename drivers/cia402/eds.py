"""The electronic data sheet of a drive: whether it has what a run needs. Before the run, never in the loop.

The sheet is read with the package canopen, an extra.
"""

from pathlib import Path
from typing import Any

from drivers.cia402 import objects as o
from drivers.cia402.objects import Key, place
from drivers.errors import ConfigurationError

_WRITTEN: tuple[Key, ...] = (
    o.CONSUMER_HEARTBEAT,
    o.PRODUCER_HEARTBEAT,
    (o.RPDO, 1),
    (o.RPDO, 2),
    (o.RPDO_MAP, 0),
    (o.TPDO, 1),
    (o.TPDO, 2),
    (o.TPDO_MAP, 0),
    o.ABORT_CONNECTION,
    o.QUICK_STOP,
    o.FAULT_REACTION,
    o.MODE,
    o.MAX_TORQUE,
)
_READ: tuple[Key, ...] = (o.DEVICE_TYPE, o.MODE_SHOWN, o.RATED_TORQUE)
_MAPPED: tuple[Key, ...] = (o.CONTROLWORD, o.TARGET_TORQUE, o.STATUSWORD, o.POSITION, o.TORQUE)


def check_eds(path: str, *, velocity: bool) -> None:
    """Read a data sheet. velocity: whether 0x606C has to fit into a second TPDO.

    Raises ConfigurationError if the package canopen is not there, if the sheet cannot be read, and with all
    that the drive lacks.
    """
    try:
        import canopen  # noqa: PLC0415 - an extra
    except ImportError:
        raise ConfigurationError(
            "drives.options.eds: a data sheet is read with the package canopen: pip install "
            "'hexapod-hil[canopen]', or leave the key out"
        ) from None
    if not Path(path).is_file():
        raise ConfigurationError(f"drives.options.eds: no such file: {path}")
    try:
        found = canopen.import_od(path)
    except Exception as error:  # the reader raises whatever its parser meets
        raise ConfigurationError(f"drives.options.eds: {path} cannot be read: {error!r}") from error
    lacks = _lacks(found, velocity=velocity)
    if lacks:
        raise ConfigurationError(
            f"drives.options.eds: by {path} the drive lacks what cia402 needs: {'; '.join(lacks)}"
        )


def _lacks(found: Any, *, velocity: bool) -> list[str]:
    second = ((o.TPDO + 1, 1), (o.TPDO_MAP + 1, 0)) if velocity else ()
    mapped = (*_MAPPED, o.VELOCITY) if velocity else _MAPPED
    lacks = []
    for key in (*_READ, *_WRITTEN, *second, *mapped):
        variable = _variable(found, key)
        if variable is None:
            lacks.append(f"{place(key)} is not there")
        elif key in (*_WRITTEN, *second) and not variable.writable:
            lacks.append(f"{place(key)} cannot be written")
        elif key in mapped and not variable.pdo_mappable:
            lacks.append(f"{place(key)} cannot be mapped")
    return lacks


def _variable(found: Any, key: Key) -> Any:
    index, sub = key
    if index not in found:
        return None
    entry = found[index]
    if not hasattr(entry, "subindices"):
        return entry if sub == 0 else None
    return entry[sub] if sub in entry.subindices else None
