"""What faults a configuration or a command cannot have."""

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


def not_brought_about(plant: PlantSettings, kind: str) -> str:
    """Return why a kind of fault comes to nothing at a plant; empty where it has something to act on."""
    model, acts = plant.model, FAULTS[kind]
    if isinstance(model, BenchPlant) and issubclass(acts, LOADS):
        return f"{kind} needs a platform, and plant type bench has none: use another plant or kind"
    if isinstance(model, FmuPlant) and issubclass(acts, PayloadStep):
        return f"{kind} needs the pose of the platform, which no FMU of one's own tells: use wrench_step"
    for kinds, key in ((WrenchStep, "wrench"), (BRAKES, "brake")):
        if isinstance(model, FmuPlant) and issubclass(acts, kinds) and not getattr(model, key):
            return f"{kind} needs inputs of the FMU: map six in plant.model.{key}, or use another kind"
    return ""


def not_carried(fault: Fault, bus: BusSettings, drives: DriveSettings) -> str:
    """Return why a foreign command cannot be sent with its force; empty where it can, or is none."""
    if not isinstance(fault, (BusSecondController, FramesForgedCommand)):
        return ""
    from plant_fmu.faults.stranger import forged  # noqa: PLC0415 - compiled code, where it is needed alone

    try:
        protocol = build_protocol(bus, drives)
    except HilError:  # which the rule on the bus load says
        return ""
    try:
        forged(protocol, fault.force_N, 0)
    except ProtocolError as error:
        return f"{str(error).partition(';')[0]}, given: {fault.force_N:g}"
    return ""


def of_no_bus(fault: Fault, bus: BusSettings) -> str:
    """Return what is wrong with the bus that a fault names; empty where there is such a bus, or none."""
    last, given = len(bus.buses) - 1, getattr(fault, "bus", None) or 0
    if given <= last:
        return ""
    allowed = "0, there is one bus" if last == 0 else f"0 to {last}, the place in bus.channels"
    return f"no such bus, allowed: {allowed}, given: {given}"


def refuse_what_no_bus_has(faults: Sequence[Fault], bus: BusSettings, drives: DriveSettings) -> None:
    """Raise ConfigurationError for a bus that there is not, and for a force that no frame carries."""
    found = [(fault.kind, of_no_bus(fault, bus) or not_carried(fault, bus, drives)) for fault in faults]
    if wrong := [f"{kind}: {text}" for kind, text in found if text]:
        raise ConfigurationError(*wrong)


def cannot_serve(command: str, faults: Sequence[Fault]) -> Iterator[str]:
    """Say which faults `sim` or `plant` cannot bring about, and what to do instead."""
    for n, fault in enumerate(faults):
        place = f"plant.faults[{n}]: {fault.kind}"
        if command == "sim" and isinstance(fault, PROCESS):
            yield (
                f"{place}: a simulation has no process of its own; allowed in real time: `hil plant`, "
                "`hil run --plant`"
            )
        if command == "plant" and fault.mode is not None:
            yield (
                f"{place}: mode {fault.mode}: the plant's end does not know the controller's mode; leave "
                "mode out and count at_s from the drives' power-up, or use `hil sim`"
            )


def refuse_on_trestles(faults: Sequence[Fault]) -> None:
    """Raise ConfigurationError for faults that a bench of `hil plant --bench` would not have."""
    wrong = [
        f"plant.faults[{n}]: {fault.kind}: the drives of --bench have the mistakes of --mistake and no "
        f"faults; allowed with it: {', '.join(kind.model_fields['kind'].default for kind in PROCESS)}"
        for n, fault in enumerate(faults)
        if not isinstance(fault, PROCESS)
    ]
    if wrong:
        raise ConfigurationError(*wrong)
