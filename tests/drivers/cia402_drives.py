"""CiA 402 drives for tests: a screw of 20 mm, 2^17 counts per turn, rated torque 9 N m."""

from typing import Any

from drivers.cia402 import objects as o
from drivers.cia402.protocol import Cia402Protocol
from drivers.cia402.states import State
from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from drivers.protocol import DriveSetup
from drivers.signals import DriveState, Reaction
from hil.contracts.by_value import Remembered
from hil.contracts.drives_end import memory_of
from plant_fmu.drives import drives_end
from plant_fmu.drives.cia402_dictionary import PLACE, fill_pdos

NODES = (1, 2, 3, 4, 5, 6)
COUNTS = 131072
SCREW_m = 0.02
RATED_Nm = 9.0
STEP_m = SCREW_m / COUNTS
PERMILLE_N = 2 * 3.141592653589793 * 1e-3 * RATED_Nm / SCREW_m


def settings(**changes) -> TransmissionSettings:
    return TransmissionSettings(**{
        "lead_m": SCREW_m,
        "counts_per_turn": COUNTS,
        "sign": [1, -1, 1, -1, 1, 1],
        "offset_m": [0.75, 0.75, 0.75, 0.75, 0.75, 0.5],
        **changes,
    })  # fmt: skip


def made(node_ids: Any, gear: TransmissionSettings, **given: Any) -> Cia402Protocol:
    """Codec from keys of the section `drives` (force_limit_N, heartbeat_ms) and options (all others)."""
    options: dict[str, Any] = {"rated_torque_Nm": RATED_Nm}
    own: dict[str, Any] = {key: given.pop(key) for key in ("force_limit_N", "heartbeat_ms") if key in given}
    bus = BusSettings(layout="classic")
    section = DriveSettings(protocol="cia402", transmission=gear, options=options | given)
    return Cia402Protocol(bus, section.model_copy(update={"node_ids": list(node_ids), **own}))


def drives(node_ids=NODES, *, velocity=True, rated_Nm=RATED_Nm, **changes) -> Any:
    word = "pdo" if velocity else "difference"
    own = {"force_limit_N": 10_000.0, "heartbeat_ms": 24.0}
    return made(node_ids, settings(**changes), velocity=word, rated_torque_Nm=rated_Nm, **own)


DEVICE_STATES = {
    DriveState.BOOT: State.NOT_READY,
    DriveState.OFF: State.DISABLED,
    DriveState.READY: State.SWITCHED_ON,
    DriveState.RUN: State.ENABLED,
    DriveState.FAULT: State.FAULT,
}


def changed(memory: Remembered, leg: int, objects: Any = None, **fields: Any) -> Remembered:
    """Memory of six drives with changed objects and fields of one drive."""
    rows = memory.state.copy()
    for key, value in (objects or {}).items():
        rows[leg]["values"][PLACE[key]] = value
    fill_pdos(rows[leg])
    for name, value in fields.items():
        rows[leg][name] = value
    return Remembered(rows)


def holding(protocol: Any, states: Any) -> Remembered:
    """Memory of six configured drives in these DriveStates (6,)."""
    memory = Remembered(memory_of(drives_end(protocol)))
    setup = DriveSetup(1.0, Reaction.BRAKE, 100.0)
    for leg, steps in enumerate(protocol.plans(setup)):
        objects = {step.key: step.value for step in steps if step.kind == "write"}
        state = DEVICE_STATES[DriveState(int(states[leg]))]
        memory = changed(memory, leg, objects, nmt=o.OPERATES, state=state)
    return memory
