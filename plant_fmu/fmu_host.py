"""FmuHost: any co-simulation FMU, 2.0 or 3.0, inside this process.

Rule of the room: fmpy loads the library; each step then calls the C functions with arguments prepared once.
The FMU shares our process: it can crash it. FMUs that we did not build belong into a child process.
"""

from __future__ import annotations

import contextlib
import ctypes as ct
import functools
import math
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi2 import fmi2CallbackAllocateMemoryTYPE as _Allocate
from fmpy.fmi2 import fmi2CallbackFreeMemoryTYPE as _Free
from fmpy.fmi3 import FMU3Slave
from numpy.typing import NDArray

from drivers.errors import PlantError
from plant_fmu.fmu_archive import checked_members, extract, open_archive, read_member
from plant_fmu.fmu_check import Interface, read_interface
from plant_fmu.fmu_spec import FmuSpec
from plant_fmu.plant import Truth

Array = NDArray[np.float64]
_WARNING = 1
"""The worst status of both standards that still is a success."""
_MESSAGES = 20
_LABELS = {2: "discard", 3: "error", 4: "fatal", 5: "pending"}


def _prepare(fmu: Any, name: str, *arguments: Any) -> Callable[[], int]:
    """Return a call of one C function with fixed arguments; the caller keeps what pointers point to."""
    address = ct.cast(fmu._functions[name], ct.c_void_p).value  # noqa: SLF001 - fmpy's only table of them
    assert address is not None
    return functools.partial(ct.CFUNCTYPE(ct.c_int, *[type(a) for a in arguments])(address), *arguments)


class _Transfer(NamedTuple):
    """A get or set of some values, with the memory that it uses."""

    call: Callable[[], int]
    references: Any
    values: Array


def _transfer(fmu: Any, name: str, references: list[int], values: Array, *, counted: bool) -> _Transfer:
    """Prepare a call that gets or sets `values`; FMI 3 counts the values, too."""
    vr = (ct.c_uint * len(references))(*references)
    pointers = (ct.c_void_p(fmu.component), ct.c_void_p(ct.addressof(vr)), ct.c_size_t(len(references)))
    tail = (ct.c_size_t(values.size),) if counted else ()
    return _Transfer(_prepare(fmu, name, *pointers, ct.c_void_p(values.ctypes.data), *tail), vr, values)


class FmuHost:
    """Plant in front of one FMU instance.

    Mutable state: the FMU instance, the tick count behind the communication time, the transfer buffers,
    the inputs that the FMU holds.
    Closing terminates and frees the instance and removes the folder that the FMU was unpacked to.
    """

    def __init__(self, spec: FmuSpec) -> None:
        """Unpack, check, load and instantiate; `reset` initialises. Raises PlantError."""
        self.spec = spec
        self.internal_step_s = spec.step_s
        self._fmu: Any = None
        self._initialised = False
        self._used = False
        self._messages: list[str] = []
        self._folder = tempfile.TemporaryDirectory(prefix="fmu-", ignore_cleanup_errors=True)
        try:
            with open_archive(spec.path) as archive:
                names = [m.filename for m in checked_members(archive, spec.path)]
                xml = read_member(archive, "modelDescription.xml", spec.path)
                self._interface: Interface = read_interface(xml, names, spec)
                extract(archive, spec.path, Path(self._folder.name))
            self._load()
            self._prepare_calls()
            self.reset()
        except BaseException:
            self.close()
            raise

    def _load(self) -> None:
        description = self._interface.description
        simulation = description.coSimulation
        library = Path(self._folder.name) / self._interface.library
        common = {
            "guid": description.guid,
            "unzipDirectory": self._folder.name,
            "modelIdentifier": simulation.modelIdentifier,
            "instanceName": "plant",
        }
        here = Path.cwd()
        try:
            if self._interface.major == 2:
                fmu = FMU2Slave(**common, libraryPath=str(library))
                fmu.instantiate(callbacks=self._callbacks_2())
            else:
                fmu = FMU3Slave(**common)
                fmu.instantiate(logMessage=lambda _env, _status, _category, message: self._log(message))
        except AttributeError as error:
            raise PlantError(
                f"{self.spec.path}: the binary lacks a function of FMI {description.fmiVersion}: {error}"
            ) from error
        except Exception as error:
            raise PlantError(f"{self.spec.path}: the FMU cannot be loaded: {error}{self._said()}") from error
        finally:
            os.chdir(here)  # fmpy stays in the library's folder when loading fails
        self._fmu = fmu
        fmu.component = ct.c_void_p(fmu.component).value

    def _callbacks_2(self) -> Any:
        callbacks = fmi2CallbackFunctions()
        callbacks.logger = fmi2CallbackLoggerTYPE(
            lambda _env, _name, _status, _category, message: self._log(message)
        )
        callbacks.allocateMemory = _Allocate(fmpy.calloc)
        callbacks.freeMemory = _Free(fmpy.free)
        try:
            from fmpy.logging import addLoggerProxy  # noqa: PLC0415 - a binary that not every machine has
        except (ImportError, OSError):
            return callbacks  # messages then come without their arguments filled in
        addLoggerProxy(ct.byref(callbacks))
        return callbacks

    def _log(self, message: bytes | None) -> None:
        self._messages.append((message or b"").decode("utf-8", "replace").strip())
        del self._messages[:-_MESSAGES]

    def _said(self) -> str:
        said = "; ".join(m for m in self._messages if m)
        self._messages.clear()
        return f": {said}" if said else ""

    def _prepare_calls(self) -> None:
        face, fmu = self._interface, self._fmu
        three = face.major >= 3
        get, put = ("fmi3GetFloat64", "fmi3SetFloat64") if three else ("fmi2GetReal", "fmi2SetReal")
        self._inputs = np.zeros(sum(c.count for c in face.inputs.values()))
        self._slots: dict[str, Array] = {}
        place = 0
        for key, channel in face.inputs.items():
            self._slots[key] = self._inputs[place : place + channel.count]
            place += channel.count
        self._outputs = np.zeros(sum(c.count for c in face.outputs.values()))
        references = [r for c in face.inputs.values() for r in c.references]
        given = [r for c in face.outputs.values() for r in c.references]
        self._transfers = transfers = [
            _transfer(fmu, put, references, self._inputs, counted=three),
            _transfer(fmu, get, given, self._outputs, counted=three),
        ]
        self._set_inputs, self._get_outputs = transfers[0].call, transfers[1].call
        component = ct.c_void_p(fmu.component)
        self._time, self._dt, self._last = ct.c_double(), ct.c_double(), ct.c_double()
        self._flags = [ct.c_bool() for _ in range(3)]
        self._event, self._ended, self._early = self._flags
        if three:
            pointers = [ct.c_void_p(ct.addressof(x)) for x in self._flags]
            pointers.append(ct.c_void_p(ct.addressof(self._last)))
            self._do_step = _prepare(
                fmu, "fmi3DoStep", component, self._time, self._dt, ct.c_bool(True), *pointers
            )
        else:
            self._do_step = _prepare(fmu, "fmi2DoStep", component, self._time, self._dt, ct.c_int(1))

    def _refused(self, status: int, what: str) -> PlantError:
        label = _LABELS.get(status, str(status))
        return PlantError(f"{self.spec.path}: the FMU refused to {what} ({label}){self._said()}")

    def _initialise(self) -> None:
        fmu = self._fmu
        if fmu is None:
            raise PlantError(f"{self.spec.path}: the FMU is closed; open it again")
        try:
            if self._used:
                fmu.reset()
            self._initialised, self._used = False, True
            if self._interface.major == 2:
                fmu.setupExperiment(startTime=0.0)
            for start in self._interface.starts:
                self._set_start(start.setter, list(start.references), list(start.values), start.name)
            fmu.enterInitializationMode()
            self._inputs[:] = 0.0
            if "brake" in self._slots:
                self._slots["brake"][:] = 1.0
            status = self._set_inputs()
            if status <= _WARNING:
                fmu.exitInitializationMode()
        except PlantError:
            raise
        except Exception as error:
            raise PlantError(
                f"{self.spec.path}: the FMU cannot be initialised: {error}{self._said()}"
            ) from error
        if status > _WARNING:
            raise self._refused(status, "take its inputs")
        self._held = self._inputs.tobytes()
        self._initialised = True

    def _set_start(self, setter: str, references: list[int], values: list[Any], name: str) -> None:
        try:
            getattr(self._fmu, f"set{setter}")(references, values)
        except Exception as error:
            raise PlantError(
                f"{self.spec.path}: the FMU refused parameter {name!r} = {values}"
                f"{self._said() or f': {error}'}"
            ) from error

    def reset(self) -> tuple[Array, Array]:
        """Initialise again with the same parameters: force 0, brakes engaged, no wrench.

        Returns lengths (6,) m and rates (6,) m/s. Raises PlantError if the FMU
        refuses or a value is not finite.
        """
        self._initialise()
        self._ticks = 0
        return self._measured()

    def _measured(self) -> tuple[Array, Array]:
        """Read all outputs at once, true ones included: a second call would cost more than their values."""
        if (status := self._get_outputs()) > _WARNING:
            raise self._refused(status, "give its outputs")
        y = self._outputs[:12].copy()
        if not math.isfinite(sum(y.tolist())):  # faster than numpy's test for so few
            said = self._said()
            raise PlantError(f"{self.spec.path}: the FMU gave a value that is not finite: {y}{said}")
        return y[:6], y[6:]

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        """Hold the inputs for `dt_s` and return lengths (6,) m and rates (6,) m/s at its end.

        The communication time is k times `internal_step_s`, not a sum. Inputs that the FMU does not have are
        dropped. Raises PlantError on a dt that is no multiple of the internal step (1e-9 relative), a value
        that is not finite, or a call that the FMU refuses; its own message is part of the error's.
        """
        step = self.internal_step_s
        n = round(dt_s / step) if 0.0 < dt_s < 1e9 * step else 0
        if n < 1 or abs(dt_s - n * step) > 1e-9 * dt_s:
            raise PlantError(f"a step of {dt_s!r} s is no multiple of the plant's step of {step!r} s")
        slots = self._slots
        slots["force"][:] = force
        if "brake" in slots:
            slots["brake"][:] = brake
        if "wrench" in slots:
            slots["wrench"][:] = wrench
        if not self._initialised:
            raise PlantError(f"{self.spec.path}: the FMU is closed or failed to initialise; reset it")
        if (held := self._inputs.tobytes()) != self._held:  # an FMU holds its inputs until they are set again
            if not math.isfinite(sum(self._inputs.tolist())):
                raise PlantError(f"force {force}, brake {brake}, wrench {wrench}: a value is not finite")
            self._held = b""  # unknown, should the FMU refuse some of them
            if (status := self._set_inputs()) > _WARNING:
                raise self._refused(status, "take its inputs")
            self._held = held
        self._time.value, self._dt.value = self._ticks * step, n * step
        if (status := self._do_step()) > _WARNING:
            raise self._refused(status, f"step from {self._time.value:.9g} s by {dt_s:.9g} s")
        if self._ended.value or self._early.value:
            what = "ended the simulation" if self._ended.value else "returned early"
            raise PlantError(f"{self.spec.path}: the FMU {what} at {self._last.value:.9g} s{self._said()}")
        self._ticks += n
        return self._measured()

    def truth(self) -> Truth | None:
        """Pose, twist and applied forces now; None where the FMU is not known to have them."""
        if self.spec.truth is None:
            return None
        if not self._initialised:
            raise PlantError(f"{self.spec.path}: the FMU is closed or failed to initialise; reset it")
        y = self._outputs[12:].copy()
        return Truth(p=y[:3], R=y[3:12].reshape(3, 3), twist=y[12:18], applied_force=y[18:])

    def close(self) -> None:
        """Terminate, free, unload, remove the unpacked files. A second call does nothing."""
        fmu, self._fmu = self._fmu, None
        initialised, self._initialised = self._initialised, False
        try:
            if fmu is not None:
                if initialised:
                    # An FMU in its error state refuses; it is freed all the same.
                    with contextlib.suppress(Exception):
                        fmu.terminate()
                fmu.freeInstance()
        except Exception as error:
            raise PlantError(
                f"{self.spec.path}: the FMU failed while closing: {error}{self._said()}"
            ) from error
        finally:
            self._folder.cleanup()
