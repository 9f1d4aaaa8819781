"""FmuNodes: drives that come as CAN FMUs, and the plant that they move.

Time is that of `Nodes`: the plant moves on a grid of its internal step. At a frame, a countdown and each
communication step the plant goes to the nearest grid point, the FMUs get lengths extrapolated to the instant,
and their forces hold until the next instant.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array, Rows
from drivers.can.bus_time import BitTiming
from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError, PlantError
from drivers.family import Family
from drivers.frame_array import NO_FRAMES, received_frames, timed_array
from drivers.protocol import ERROR, Frame, Received, off_bus
from drivers.signals import LEGS, DriveState
from plant_fmu.config import DriveEmulation, DriveFmus
from plant_fmu.drives.drive import Snapshot
from plant_fmu.drives.drive_rules import NEVER_NS
from plant_fmu.drives.nodes import Nodes
from plant_fmu.faults.kinds import LOADS, PROCESS
from plant_fmu.faults.plan import FaultPlan
from plant_fmu.fmu.check import Reader, Start
from plant_fmu.network import operations as op
from plant_fmu.network.node import Node, Signals
from plant_fmu.network.station import Station, Stations
from plant_fmu.network.terminal import CanFmu, read_can_fmu
from plant_fmu.plant import Plant

_VARIABLES: dict[str, tuple[str, tuple[str, ...], set[str]]] = {
    "length": ("input", ("m",), {"Float64"}),
    "rate": ("input", ("m/s",), {"Float64"}),
    "force": ("output", ("N",), {"Float64"}),
    "brake": ("output", (), {"Float64", "Boolean"}),
}
"""Key of the section -> causality, units, types."""
_INPUTS, _OUTPUTS = ("length", "rate"), ("force", "brake")


class _Drive(NamedTuple):
    """One CAN FMU with the drives of `legs`."""

    fmu: CanFmu
    legs: slice
    starts: list[Start]
    signals: dict[str, Signals]
    """Key of the section -> variables."""


def _drive(path: Path, settings: DriveFmus, leg: int | None) -> _Drive:
    """Read and check one FMU; leg: that of its only drive, None for all six. Raises PlantError."""
    fmu, count = read_can_fmu(path), LEGS if leg is None else 1
    reader, found, starts = Reader(fmu.description, str(path), settings.assume_unit), {}, []
    for key, (causality, units, types) in _VARIABLES.items():
        if names := getattr(settings, key):
            references = reader.channel(key, names, causality, units, count, types)
            found[key] = Signals(references, count, reader.find(names[0])[0].type)
    for name, value in settings.parameters.items():
        if leg is not None and isinstance(value, list) and len(value) == LEGS:
            value = value[leg]  # noqa: PLW2901 - its own element
        starts.append(reader.start(name, value))
    return _Drive(fmu, slice(0, LEGS) if leg is None else slice(leg, leg + 1), starts, found)


class DrivenPlant:
    """A plant that reports and closes together with the CAN FMUs of its drives."""

    def __init__(self, plant: Plant, nodes: "FmuNodes") -> None:
        self._plant, self._nodes = plant, nodes

    def __getattr__(self, name: str) -> Any:
        """Everything else is that of the plant."""
        return getattr(self._plant, name)

    def notes(self) -> list[str]:
        """Notes of the plant and of the FMUs."""
        return self._plant.notes() + self._nodes.notes()

    def close(self) -> None:
        """Close FMUs and plant."""
        try:
            self._nodes.close()
        finally:
            self._plant.close()


class FmuNodes(Nodes):
    """CAN FMUs as drives: the drives' side of the bus, as `Nodes`.

    The FMUs receive the controller's frames, not those of each other. BusNotifications stays false: they must
    not wait for Confirm. Of the faults those of the load and of the process act.

    Mutable state: that of `Nodes`, the hosted FMUs, frames of the start. `start` resets it.
    """

    def __init__(
        self,
        plant: Plant,
        protocol: Family,
        emulation: DriveEmulation,
        drives: DriveSettings,
        faults: FaultPlan,
        folder: Path,
        bus: BusSettings,
    ) -> None:
        """Read and host the FMUs; relative paths start at `folder`.

        Raises PlantError: an FMU cannot be hosted, or configures other bit rates than section `bus`.
        ConfigurationError: a fault that acts on emulated drives or frames.
        """
        assert emulation.fmu is not None
        if wrong := [each.kind for each in faults.faults if not isinstance(each, (*LOADS, *PROCESS))]:
            allowed = [kind.model_fields["kind"].default for kind in (*LOADS, *PROCESS)]
            raise ConfigurationError(
                f"plant.faults: {', '.join(wrong)}: drives that are CAN FMUs have only these faults: "
                f"{', '.join(allowed)}"
            )
        paths = [folder / each for each in emulation.fmu.path]
        self._fmus = [
            _drive(path, emulation.fmu, leg if len(paths) > 1 else None) for leg, path in enumerate(paths)
        ]
        self._timing = None if bus.layout == "ideal" else BitTiming.of(bus)
        self.stations = Stations()
        self.plant: Any = DrivenPlant(plant, self)
        """The plant, which closes the FMUs too."""
        try:
            super().__init__(plant, protocol, emulation, drives, faults)
        except BaseException:
            self.close()
            raise

    def start(self, t0_ns: int) -> None:
        """Power up at `t0_ns`: plant at its initial state, FMUs new. Raises PlantError as the constructor."""
        assert self._emulation.fmu is not None
        self._begin(t0_ns)
        self._step_ns = round(max(1, round(self._emulation.fmu.step_us * 1e3 / self._h_ns)) * self._h_ns)
        self._set_wrench()
        if not self.stations or any(station.node.reached_ns for station in self.stations):
            self.close()
            for drive in self._fmus:
                inputs = self._inputs(drive, self._record["length"])
                name = f"{drive.fmu.path.name}, leg {drive.legs.start}"
                node = Node(drive.fmu, name, notifications=False, starts=drive.starts, inputs=inputs)
                self.stations.append(Station(node))
            self._waits: list[tuple[int, Frame]] = []
            self._first = [each.frame for each in received_frames(self.advance(t0_ns, NO_FRAMES))]
        self._waits = [(t0_ns, frame) for frame in self._first]
        self._read_outputs()
        if self._timing is not None and (found := self.stations.bit_rates(self._timing)) != self._timing:
            raise PlantError(
                f"{self._fmus[0].fmu.path}: it configures {found.bitrate} and {found.data_bitrate} bit/s, "
                f"section bus {self._timing.bitrate} and {self._timing.data_bitrate}: set the same"
            )

    def advance(self, t_ns: int, received: Rows) -> Rows:
        """Advance to `t_ns`, receiving FRAME records; returns the frames of the FMUs, in time order."""
        self._check_time(t_ns)
        heard = sorted(received_frames(received), key=lambda each: each.t_ns)
        heard = [each._replace(t_ns=min(each.t_ns, t_ns)) for each in heard]
        sent, self._waits = self._waits, []
        while True:
            due_ns = min([self._due_ns(), *(each.t_ns for each in heard[:1])])
            at_ns = min(max(due_ns, self.now_ns), t_ns)
            early = [each for each in heard if each.t_ns <= at_ns]
            heard = heard[len(early) :]
            sent += [(at_ns, frame) for frame in self._go(at_ns, early)]
            if at_ns == t_ns and not heard and self._due_ns() > t_ns:
                return timed_array(sent) if sent else NO_FRAMES

    def answer(self, t_ns: int, received: Rows, awaited: Iterable[int], deadline_ns: int) -> Rows:
        """Advance to `t_ns`, and on until the `awaited` identifiers are sent, at most to `deadline_ns`."""
        out = [self.advance(t_ns, received)]
        missing = set(awaited).difference(out[0]["id"].tolist())
        while missing and (due_ns := max(self._due_ns(), self.now_ns)) <= deadline_ns:
            out.append(self.advance(due_ns, NO_FRAMES))
            missing.difference_update(out[-1]["id"].tolist())
        return np.concatenate(out)

    @property
    def address(self) -> int:
        """Always 0: only `advance` is possible."""
        return 0

    @property
    def unasked(self) -> bool:
        """True: an FMU sends frames when it wants."""
        return True

    @property
    def next_reading_ns(self) -> int:
        """Time, ns, at which an FMU sends of its own accord: its countdown, else each communication step."""
        if all(station.node.fmu.countdown for station in self.stations):
            dues = (station.node.next_ns() for station in self.stations)
            return self._t0_ns + min((due for due in dues if due is not None), default=NEVER_NS)
        return self._due_ns()

    @property
    def _t0_ns(self) -> int:
        return int(self._record["t0_ns"])

    def snapshot(self) -> Snapshot:
        """State now: a drive is OFF while its brake is engaged, else RUN; frames are counted as rejected.

        SYNCs and commands stay 0: what the frames mean is known by the FMUs only.
        """
        n = self._record
        n["state"] = np.where(n["brake"] > 0.0, int(DriveState.OFF), int(DriveState.RUN))
        n["rejected"] = sum(station.corrupt + station.reported for station in self.stations)
        n["command"] = n["force"]
        return super().snapshot()

    def notes(self) -> list[str]:
        """Operations of FMUs that could not be read, and those that they could not read."""
        return [
            f"{s.node.name}: {s.corrupt} operations could not be read, {s.reported} Format Errors"
            for s in self.stations
            if s.corrupt or s.reported
        ]

    def close(self) -> None:
        """Free the FMUs. A second call does nothing."""
        for station in self.stations:
            station.node.close()
        self.stations.clear()

    def _due_ns(self) -> int:
        """Next time, ns, at which something happens without a frame."""
        own_ns = self.stations.next_ns(self.now_ns - self._t0_ns, self._step_ns)
        return min([self._t0_ns + own_ns, *self._edges[:1]])

    def _go(self, at_ns: int, heard: Sequence[Received]) -> list[Frame]:
        """Move plant and FMUs to an instant; returns the frames that the FMUs send."""
        n, since_ns = self._record, at_ns - self._t0_ns
        k, n["now_ns"] = round(since_ns / self._h_ns), at_ns
        if (steps := k - int(n["k"])) > 0:
            force, brake, wrench = (n[name].copy() for name in ("force", "brake", "wrench"))
            n["length"], n["rate"] = self._plant.step(force, brake, wrench, steps * self._h_s)
            n["k"] = k
        while self._edges and self._edges[0] <= at_ns:
            del self._edges[0]
            self._present = self.schedule.present(at_ns)
        self._set_wrench()
        length = n["length"] + n["rate"] * (1e-9 * (since_ns - round(k * self._h_ns)))
        for drive, station in zip(self._fmus, self.stations, strict=True):
            for each in self._inputs(drive, length):
                station.node.put(each)
        operations = [op.from_frame(off_bus(frame)) for _, frame in heard if not frame.flags & ERROR]
        for station in self.stations:
            if station.status != op.BUS_OFF:
                station.inbox += operations
        sent = [op.to_frame(operation) for _, operation in self.stations.go(since_ns, 1)]
        self._read_outputs()
        return sent

    def _inputs(self, drive: _Drive, length: Array) -> list[Signals]:
        """Input variables of a drive, set to `length` and the rates."""
        for key, values in zip(_INPUTS, (length, self._record["rate"]), strict=True):
            if signals := drive.signals.get(key):
                signals.values[:] = values[drive.legs]
        return [drive.signals[key] for key in _INPUTS if key in drive.signals]

    def _read_outputs(self) -> None:
        for drive, station in zip(self._fmus, self.stations, strict=True):
            for key in _OUTPUTS:
                if signals := drive.signals.get(key):
                    station.node.get(signals)
                    self._record[key][drive.legs] = signals.values
