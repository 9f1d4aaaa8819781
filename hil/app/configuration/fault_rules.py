"""Checks faults to inject against a configuration and a command."""

from collections.abc import Iterator, Sequence

from drivers import build_protocol
from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError, HilError, ProtocolError
from plant_fmu.config import BenchPlant, FmuPlant, PlantSettings
from plant_fmu.faults import FAULTS
from plant_fmu.faults.fault import Fault
from plant_fmu.faults.kinds import (
    BRAKES,
    LOADS,
    PROCESS,
    BusSecondController,
    FramesForgedCommand,
    PayloadStep,
    WrenchStep,
)


def without_effect(plant: PlantSettings, kind: str) -> str:
    """Reason why a kind of fault has no effect at a plant; empty if it has an effect."""
    model, acts = plant.model, FAULTS[kind]
    if isinstance(model, BenchPlant) and issubclass(acts, LOADS):
        return f"{kind} needs a platform, but plant type bench has none: use another plant or kind"
    if isinstance(model, FmuPlant) and issubclass(acts, PayloadStep):
        return f"{kind} needs the pose of the platform, which a custom FMU does not report: use wrench_step"
    for kinds, key in ((WrenchStep, "wrench"), (BRAKES, "brake")):
        if isinstance(model, FmuPlant) and issubclass(acts, kinds) and not getattr(model, key):
            return f"{kind} needs inputs of the FMU: map six in plant.model.{key}, or use another kind"
    return ""


def force_not_carried(fault: Fault, bus: BusSettings, drives: DriveSettings) -> str:
    """Reason why a forged command frame cannot carry the fault's force, N; empty if it can."""
    if not isinstance(fault, (BusSecondController, FramesForgedCommand)):
        return ""
    from plant_fmu.faults.foreign_controller import forged  # noqa: PLC0415 - compiled code, where it is needed alone

    try:
        protocol = build_protocol(bus, drives)
    except HilError:  # the rule on the bus load reports it
        return ""
    try:
        forged(protocol, fault.force_N, 0)
    except ProtocolError as error:
        return f"{str(error).partition(';')[0]}, given: {fault.force_N:g}"
    return ""


def unknown_bus(fault: Fault, bus: BusSettings) -> str:
    """Problem with the bus number of a fault; empty for an existing bus, or for a fault without one."""
    last, given = len(bus.buses) - 1, getattr(fault, "bus", None) or 0
    if given <= last:
        return ""
    allowed = "0, as there is one bus" if last == 0 else f"0 to {last}, the index in bus.channels"
    return f"unknown bus, allowed: {allowed}, given: {given}"


def require_bus(faults: Sequence[Fault], bus: BusSettings, drives: DriveSettings) -> None:
    """Raise ConfigurationError for faults on an unknown bus, or with a force that no frame carries."""
    found = [
        (fault.kind, unknown_bus(fault, bus) or force_not_carried(fault, bus, drives)) for fault in faults
    ]
    if wrong := [f"{kind}: {text}" for kind, text in found if text]:
        raise ConfigurationError(*wrong)


def cannot_serve(command: str, faults: Sequence[Fault]) -> Iterator[str]:
    """Yield faults that command `sim` or `plant` cannot produce, and what to do instead."""
    for n, fault in enumerate(faults):
        place = f"plant.faults[{n}]: {fault.kind}"
        if command == "sim" and isinstance(fault, PROCESS):
            yield (
                f"{place}: a simulation has no separate process; allowed in real time: `hil plant`, "
                "`hil run --plant`"
            )
        if command == "plant" and fault.mode is not None:
            yield (
                f"{place}: mode {fault.mode}: the plant's end does not know the controller's mode; leave "
                "mode out and count at_s from the drives' power-up, or use `hil sim`"
            )


def require_bench_faults(faults: Sequence[Fault]) -> None:
    """Raise ConfigurationError for faults that `hil plant --bench` does not support."""
    wrong = [
        f"plant.faults[{n}]: {fault.kind}: the drives of --bench accept --mistake, but no "
        f"faults; allowed with it: {', '.join(kind.model_fields['kind'].default for kind in PROCESS)}"
        for n, fault in enumerate(faults)
        if not isinstance(fault, PROCESS)
    ]
    if wrong:
        raise ConfigurationError(*wrong)
