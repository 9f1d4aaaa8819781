"""Node: one CAN FMU in this process, in the event mode of FMI 3.0.

Times are whole ns from the start of the simulation. The FMU can crash this process, as any FMU.
"""

import contextlib
import ctypes as ct
import tempfile
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from drivers.errors import PlantError
from plant_fmu.fmu.archive import extract, open_archive
from plant_fmu.fmu.check import Start, shown
from plant_fmu.fmu.host import instantiate
from plant_fmu.network.terminal import CanFmu

_ROUNDS = 1000
"""Most event iterations at one instant; an FMU that wants more does not settle."""
_WARNING = 1
_CHANGED = 2
"""fmi3IntervalChanged."""


class Signals:
    """Variables of one type and their values, in memory for calls. Mutable state: `values`."""

    def __init__(self, references: Sequence[int], count: int, kind: str = "Float64") -> None:
        """kind: Float64 or Boolean; count: number of values, more than references if there are arrays."""
        self.values = np.zeros(count, bool if kind == "Boolean" else float)
        number: Any = ct.c_bool if kind == "Boolean" else ct.c_double
        at = (ct.c_uint32 * len(references))(*references), (number * count).from_buffer(self.values)
        self.kind, self.arguments = kind, (at[0], len(references), at[1], count)


class Node:
    """One CAN FMU with its bus terminal.

    Mutable state: the FMU instance and its unpacked files; `reached_ns`, the time that it has reached;
    `due_ns`, the time of its next countdown, None without one; whether its last step wants an event.
    """

    def __init__(
        self,
        fmu: CanFmu,
        name: str,
        *,
        notifications: bool = True,
        starts: Sequence[Start] = (),
        inputs: Sequence[Signals] = (),
    ) -> None:
        """Unpack, load and initialise the FMU at time 0; it is then in event mode.

        notifications: set its parameter BusNotifications, if it has one. starts: parameters to set. inputs:
        their values at time 0. Raises PlantError.
        """
        self.name, self.fmu = name, fmu
        self.reached_ns, self.due_ns, self._wants_event = 0, None, True
        self._slave: Any = None
        self._in_event_mode = True
        self._messages: deque[str] = deque(maxlen=5)
        self._folder = tempfile.TemporaryDirectory(prefix="fmu-", ignore_cleanup_errors=True)
        self._references = {member: (ct.c_uint32 * 1)(each) for member, each in fmu.references.items()}
        self._clock, self._on = (ct.c_bool * 1)(), (ct.c_bool * 1)(True)
        self._interval, self._qualifier = (ct.c_double * 1)(), (ct.c_int * 1)()
        self._flags, self._reals = (ct.c_bool * 5)(), (ct.c_double * 1)()
        self._flag_at = [ct.cast(ct.byref(self._flags, k), ct.POINTER(ct.c_bool)) for k in range(5)]
        self._bytes = ct.POINTER(ct.c_uint8)
        self._size, self._value = (ct.c_size_t * 1)(), (ct.POINTER(ct.c_uint8) * 1)()
        try:
            with open_archive(fmu.path) as archive:
                extract(archive, fmu.path, Path(self._folder.name))
            self._load(notifications, starts, inputs)
        except BaseException:
            self.close()
            raise

    due_ns: int | None

    def _load(self, notifications: bool, starts: Sequence[Start], inputs: Sequence[Signals]) -> None:
        try:
            slave = self._slave = instantiate(
                self._folder.name,
                self.fmu.description,
                self.fmu.library,
                lambda *given: self._messages.append((given[-1] or b"").decode(errors="replace")),
                event_mode_used=True,
                early_return_allowed=True,
            )
            self._functions = slave._functions  # noqa: SLF001 - fmpy's only table of them
            switch = self.fmu.notifications
            if notifications and switch is not None:
                if self.fmu.structural:
                    slave.enterConfigurationMode()
                slave.setBoolean([switch], [True])
                if self.fmu.structural:
                    slave.exitConfigurationMode()
            for start in starts:
                getattr(slave, f"set{start.setter}")(list(start.references), list(start.values))
            slave.enterInitializationMode(startTime=0.0)
            for each in inputs:
                self.put(each)
            slave.exitInitializationMode()
        except PlantError:
            raise
        except Exception as error:  # fmpy raises many types
            raise self._error(f"the CAN FMU cannot be started: {error}") from error

    def next_ns(self) -> int | None:
        """Next time, ns, at which it has to be stepped for its own sake; None if it only reacts."""
        due_ns, step_ns = self.reached_ns if self._wants_event else self.due_ns, self.fmu.step_ns
        return due_ns if due_ns is None or not step_ns else -(-due_ns // step_ns) * step_ns

    def put(self, signals: Signals) -> None:
        """Set input variables to `signals.values`. Raises PlantError."""
        self._call(f"fmi3Set{signals.kind}", *signals.arguments)

    def get(self, signals: Signals) -> None:
        """Fill `signals.values` from output variables. Raises PlantError."""
        self._call(f"fmi3Get{signals.kind}", *signals.arguments)

    def advance(self, to_ns: int) -> None:
        """Step to `to_ns`; an FMU of fixed step takes its last whole step before. Raises PlantError."""
        if self.fmu.step_ns:
            to_ns -= to_ns % self.fmu.step_ns
        if to_ns <= self.reached_ns:
            return
        self._enter(event_mode=False)
        for _ in range(_ROUNDS):
            begin_ns = self.reached_ns
            size_ns = self.fmu.step_ns or to_ns - begin_ns
            self._call("fmi3DoStep", begin_ns * 1e-9, size_ns * 1e-9, True, *self._flag_at[:3], self._reals)
            event, ended, early, *_ = self._flags
            last_s = self._reals[0]
            if ended:
                raise self._error(f"the FMU ended the simulation at {last_s:.9g} s")
            if early and not -1.0 < 1e9 * last_s - begin_ns < size_ns + 1.0:
                raise self._error(f"its step from {begin_ns} ns by {size_ns} ns returned early at {last_s} s")
            self.reached_ns = max(begin_ns, round(1e9 * last_s)) if early else begin_ns + size_ns
            if self.reached_ns >= to_ns:
                self._wants_event = bool(event)
                return
            if event:  # an event of its own: a bus communication point is only at the end of a step
                self._enter(event_mode=True)
                self._update()
                self._enter(event_mode=False)
        raise self._error(f"the FMU returns early from each step at {self.reached_ns} ns")

    def exchange(self, received: bytes) -> bytes:
        """Event at the time that it has reached: give it `received`, return what it sends; both may be empty.

        Does nothing if there is nothing to give, no countdown is due and its last step wants no event.
        Raises PlantError.
        """
        due = self.due_ns is not None and self.due_ns <= self.reached_ns
        if not (received or due or self._wants_event):
            return b""
        self._enter(event_mode=True)
        parts = []
        if due:
            self.due_ns = None
            self._of("fmi3SetClock", "Tx_Clock", self._on)
        if received:
            self._of("fmi3SetClock", "Rx_Clock", self._on)
            content = ct.create_string_buffer(received, len(received))
            self._value[0], self._size[0] = ct.cast(content, self._bytes), len(received)
            self._of("fmi3SetBinary", "Rx_Data", self._size, self._value, 1)
        for _ in range(_ROUNDS):
            if not self.fmu.countdown:
                self._of("fmi3GetClock", "Tx_Clock", self._clock)
                due = bool(self._clock[0])
            if due:
                self._of("fmi3GetBinary", "Tx_Data", self._size, self._value, 1)
                size, data = self._size[0], self._value[0]
                if size > self.fmu.most_sent or (size and not data):
                    given = f"{size} bytes" if data else "no data"
                    raise self._error(f"Tx_Data has {given}, its maxSize is {self.fmu.most_sent}")
                parts.append(ct.string_at(data, size) if size else b"")
            again, due = self._update(), False
            if not again:
                self._wants_event = False
                return b"".join(parts)
        raise self._error(f"its discrete states do not settle at {self.reached_ns} ns")

    def _of(self, function: str, member: str, *arguments: Any) -> None:
        """Call a function for one member of the terminal."""
        self._call(function, self._references[member], 1, *arguments)

    def _update(self) -> bool:
        """End one event iteration and read the countdown; True if another iteration is needed."""
        self._call("fmi3UpdateDiscreteStates", *self._flag_at, self._reals)
        again, ended, *_ = self._flags
        if ended:
            raise self._error(f"the FMU ended the simulation at {self.reached_ns} ns")
        if self.fmu.countdown:
            self._of("fmi3GetIntervalDecimal", "Tx_Clock", self._interval, self._qualifier)
            if self._qualifier[0] == _CHANGED:
                wait_s = self._interval[0]
                if not 0.0 <= wait_s < 1e9:
                    raise self._error(f"its Tx_Clock counts down from {wait_s:g} s")
                self.due_ns = self.reached_ns + round(wait_s * 1e9)
        return bool(again)

    def _enter(self, *, event_mode: bool) -> None:
        if self._in_event_mode != event_mode:
            self._call("fmi3EnterEventMode" if event_mode else "fmi3EnterStepMode")
            self._in_event_mode = event_mode

    def _call(self, function: str, *arguments: Any) -> None:
        if self._slave is None:
            raise self._error("the FMU is closed")
        status = self._functions[function](self._slave.component, *arguments)
        if status > _WARNING:
            raise self._error(f"{function} failed with fmi3Status {status} at {self.reached_ns} ns")

    def _error(self, what: str) -> PlantError:
        """Error with the last messages of the FMU."""
        said = shown("; ".join(filter(None, self._messages)))
        self._messages.clear()
        return PlantError(f"{self.fmu.path}: {what}{said and f': {said}'}")

    def close(self) -> None:
        """Terminate and free the FMU, remove the unpacked files. A second call does nothing."""
        slave, self._slave = self._slave, None
        try:
            if slave is not None and getattr(slave, "component", None):
                with contextlib.suppress(Exception):  # in its error state it refuses; it is freed anyway
                    slave.terminate()
                slave.freeInstance()
        finally:
            self._folder.cleanup()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
