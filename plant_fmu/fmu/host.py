"""FmuHost: any co-simulation FMU, 2.0 or 3.0, inside this process.

The FMU can crash this process. FMUs that we did not build belong into a child process.
"""

import contextlib
import ctypes as ct
import os
import sys
import tempfile
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
from fmpy.simulation import instantiate_fmu

from drivers.arrays import Array
from drivers.compiled.pointed import data_at
from drivers.errors import PlantError
from drivers.signals import LEGS
from plant_fmu.fmu import call as fmu_call
from plant_fmu.fmu.archive import extract, open_archive
from plant_fmu.fmu.check import FmuSpec, Interface, read_interface, shown
from plant_fmu.plant import Moved, PointedPlant, Truth, truth_of

_REFUSED = {fmu_call.INPUTS_REFUSED: "take its inputs", fmu_call.OUTPUTS_REFUSED: "give its outputs"}
_LABELS = {2: "discard", 3: "error", 4: "fatal", 5: "pending"}


def instantiate(folder: str, description: Any, library: str, logger: Any, **more: Any) -> Any:
    """Load and instantiate an FMU that is unpacked in `folder`; more: arguments of FMPy. Raises any error."""
    here = Path.cwd()
    try:
        with contextlib.redirect_stdout(sys.stderr):  # fmpy prints messages that it cannot format
            path = str(Path(folder) / library)
            return instantiate_fmu(
                folder, description, "CoSimulation", logger=logger, library_path=path, **more
            )
    finally:
        os.chdir(here)  # fmpy stays in the library's folder when loading fails


def _address(fmu: Any, name: str) -> int:
    address = ct.cast(fmu._functions[name], ct.c_void_p).value  # noqa: SLF001 - fmpy's only table of them
    assert address is not None
    return address


class FmuHost(PointedPlant):
    """Plant of one FMU instance. Inputs that the FMU does not have are ignored.

    Mutable state: the FMU instance, its record with the tick count behind the communication time, the
    transfer buffers, the inputs that the FMU has, what it reported. An FMU that cannot be reset is loaded and
    instantiated again instead. Closing terminates and frees the instance and removes the
    folder with the unpacked FMU. The folder of our own FMU, which needs no file but its library, is removed
    as soon as the library is loaded: a process that is killed leaves nothing behind.
    """

    def __init__(self, spec: FmuSpec) -> None:
        """Unpack, check, load, instantiate and initialise the FMU. Raises PlantError."""
        self.spec = spec
        self.internal_step_s = spec.step_us / 1e6
        self._fmu: Any = None
        self._record = np.zeros((), fmu_call.FMU)
        self._initialised = False
        self._cannot_reset = ""
        self._messages: deque[str] = deque(maxlen=20)
        self._warnings, self._first_warning = 0, ""
        self._first: Array = np.zeros(0)
        self._folder = tempfile.TemporaryDirectory(prefix="fmu-", ignore_cleanup_errors=True)
        try:
            path = Path(spec.path)
            self._interface: Interface = read_interface(spec)
            with open_archive(path) as archive:
                extract(archive, path, Path(self._folder.name))
            self._prepare_calls()
            self._load()
            if spec.truth:
                self._folder.cleanup()
            self.reset()
        except BaseException:
            self.close()
            raise

    def _load(self) -> None:
        try:
            self._fmu = instantiate(
                self._folder.name,
                self._interface.description,
                self._interface.library,
                lambda *given: self._log(given[-3], given[-1]),  # both standards end alike
            )
        except Exception as error:  # also of a binary that lacks a function
            raise self._error(f"the FMU cannot be loaded: {error}") from error
        three, record = self._interface.major >= 3, self._record
        reals = ("fmi3SetFloat64", "fmi3GetFloat64") if three else ("fmi2SetReal", "fmi2GetReal")
        functions = (*reals, "fmi3DoStep" if three else "fmi2DoStep")
        for name, function in zip(("set", "get", "step"), functions, strict=True):
            record[name] = _address(self._fmu, function)
        record["instance"], record["counted"] = self._fmu.component, three
        if (switched := self._interface.set_brake) is not None:
            record["set_brake"] = _address(self._fmu, switched[0])

    def _log(self, status: int, message: bytes | None) -> None:
        text = (message or b"").decode("utf-8", "replace").strip()
        self._messages.append(text)
        if status == fmu_call.WARNING:
            self._warnings += 1
            self._first_warning = self._first_warning or shown(text)

    def _reported(self) -> str:
        reported = "; ".join(m for m in self._messages if m)
        self._messages.clear()
        return f": {reported}" if reported else ""

    def _error(self, what: str) -> PlantError:
        return PlantError(f"{self.spec.path}: {what}{self._reported()}")

    def _prepare_calls(self) -> None:
        face = self._interface
        self._inputs = np.zeros(LEGS * len(face.inputs))
        places = {key: LEGS * n for n, key in enumerate(face.inputs)}
        self._outputs = np.zeros(fmu_call.APPLIED + LEGS if self.spec.truth else fmu_call.LENGTHS_RATES)
        self._held = np.zeros(self._inputs.size, np.int64)
        record, self._references = self._record, []
        inputs = dict(face.inputs)
        switches = () if face.set_brake is None else inputs.pop("brake")
        lists = {"set": inputs.values(), "get": face.outputs.values(), "brake": [switches]}
        for verb, channels in lists.items():
            references = np.array([each for some in channels for each in some], np.uint32)
            record[f"{verb}_references"], record[f"{verb}_count"] = data_at(references), references.size
            self._references.append(references)
        record["brake_bytes"] = 0 if face.set_brake is None else face.set_brake[1]
        self._switches = np.zeros(LEGS, np.int64)
        record["brakes"], record["offset"] = data_at(self._switches), self.spec.length_offset_m
        record["inputs"], record["input_count"] = data_at(self._inputs), self._inputs.size
        record["outputs"], record["output_count"] = data_at(self._outputs), self._outputs.size
        record["held"], record["step_s"] = data_at(self._held), self.internal_step_s
        record["slots"] = [places.get(key, -1) for key in ("force", "brake", "wrench")]
        record["known"] = bool(self.spec.truth)

    def _refused(self, status: int, what: str) -> PlantError:
        label = _LABELS.get(status, f"unknown status {status}")
        return self._error(f"the FMU refused to {what} ({label})")

    def _begin(self) -> None:
        """Initialise the FMU: first time, after a reset, or as a new instance if the reset fails."""
        if self._fmu is None:
            raise PlantError(f"{self.spec.path}: the FMU is closed; open it again")
        again, self._initialised = self._initialised, True
        if again and not self._cannot_reset:
            try:
                self._fmu.reset()
                self._initialise()
                if np.array_equal(self._outputs[: fmu_call.LENGTHS_RATES], self._first):
                    return
                self._cannot_reset = "it gives other lengths or rates after a reset than at its first start"
            except Exception as error:  # noqa: BLE001 - fmpy raises many types
                self._cannot_reset = str(error).removeprefix(f"{self.spec.path}: ")
        if again:
            self._free()
            self._load()
        self._initialise()
        self._first = self._outputs[: fmu_call.LENGTHS_RATES].copy()

    def _initialise(self) -> None:
        fmu, self._record["ready"] = self._fmu, False
        doing = "the FMU cannot be initialised"
        try:
            if self._interface.major == 2:
                fmu.setupExperiment(startTime=0.0)
            for start in self._interface.starts:
                doing = f"the FMU refused parameter {start.name!r} = {list(start.values)}"
                getattr(fmu, f"set{start.setter}")(list(start.references), list(start.values))
            doing = "the FMU cannot be initialised"
            fmu.enterInitializationMode()
            self._inputs[:] = 0.0
            if (brake := int(self._record["slots"][1])) >= 0:
                self._inputs[brake : brake + LEGS] = 1.0
            status = fmu_call.put(self._record)
            if fmu_call.succeeded(status):
                fmu.exitInitializationMode()
        except PlantError:
            raise
        except Exception as error:
            raise self._error(f"{doing}: {error}") from error
        if not fmu_call.succeeded(status):
            raise self._refused(status, "take its inputs")
        self._record["ready"], self._record["stepped"], self._record["ticks"] = True, False, 0
        ended = fmu_call.fetch(self._record)
        if ended != fmu_call.DONE:
            raise self._failed(ended)

    def reset(self) -> tuple[Array, Array]:
        """Reset the FMU and initialise it with the same parameters: force 0, brakes engaged, no wrench.

        Returns lengths (6,) m and rates (6,) m/s. Raises PlantError if the FMU
        refuses or a value is not finite.
        """
        if self._record["stepped"] or not self._record["ready"]:
            self._begin()
        y = self._outputs[: fmu_call.LENGTHS_RATES].copy()
        return y[:LEGS] + self._record["offset"], y[LEGS:]

    def _failed(self, ended: int, step: str = "") -> PlantError:
        if ended == fmu_call.CLOSED:
            return PlantError(f"{self.spec.path}: the FMU is closed or failed to initialise; reset it")
        if ended == fmu_call.OUTPUT_NOT_FINITE:
            y = self._outputs[: fmu_call.LENGTHS_RATES]
            return self._error(f"the FMU gave a value that is not finite: {y}")
        if ended == fmu_call.INTERRUPTED:
            did = "ended the simulation" if self._record["flags"][1] else "returned early"
            return self._error(f"the FMU {did} at {self._record['last'][0]:.9g} s")
        return self._refused(int(self._record["status"]), _REFUSED.get(ended, step))

    def _did_not_step(self, ended: int, force: Array, brake: Array, wrench: Array, steps: int) -> PlantError:
        if ended == fmu_call.NOT_FINITE:
            return PlantError(f"force {force}, brake {brake}, wrench {wrench}: a value is not finite")
        step_s = self.internal_step_s
        begun_s = int(self._record["ticks"]) * step_s
        error = self._failed(ended, f"step from {begun_s:.9g} s by {steps * step_s:.9g} s")
        unfit = self._interface.unfit_step(step_s) if ended == fmu_call.STEP_REFUSED else ""
        return PlantError(f"{error}; {unfit}") if unfit else error

    def moved(self) -> Moved:
        """Addresses of the compiled function of this plant and of its state, for compiled callers."""
        return Moved(fmu_call.move.address, data_at(self._record), self._did_not_step, self)

    def truth(self) -> Truth | None:
        """Pose, twist and applied forces now; None if the configuration maps no outputs for them."""
        if not self.spec.truth:
            return None
        if not self._record["ready"]:
            raise self._failed(fmu_call.CLOSED)
        return truth_of(self._outputs[fmu_call.LENGTHS_RATES :].copy())

    def rod_force(self) -> Array | None:
        """Forces (6,) N between drives and rods, read when asked; None if the FMU's output is unknown."""
        references = list(self._interface.rod_force)
        if not references:
            return None
        three = self._interface.major >= 3
        return np.array(self._fmu.getFloat64(references, LEGS) if three else self._fmu.getReal(references))

    def notes(self) -> list[str]:
        """Warnings about a failed reset, and the number and first text of the FMU's warnings."""
        found, reason = [], self._cannot_reset
        if reason:
            found.append(f"the FMU cannot be reset, so each new start gets a fresh instance of it: {reason}")
        if self._warnings:
            first = f"the first message: {self._first_warning}"
            found.append(f"warnings of the FMU: {self._warnings}, {first}")
        return found

    def close(self) -> None:
        """Terminate, free and unload the FMU, remove the unpacked files. A second call does nothing."""
        try:
            self._free()
        finally:
            self._folder.cleanup()

    def _free(self) -> None:
        fmu, self._fmu = self._fmu, None
        initialised, self._record["ready"] = bool(self._record["ready"]), False
        try:
            if fmu is not None:
                if initialised:
                    # An FMU in its error state refuses; it is freed anyway.
                    with contextlib.suppress(Exception):
                        fmu.terminate()
                fmu.freeInstance()
        except Exception as error:
            raise self._error(f"the FMU failed while closing: {error}") from error
