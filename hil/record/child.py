"""Recorder at the other end of a link: start it, send its set-up, receive its answers, wait for its end.

On Linux it is a process. Elsewhere, where there is no shared memory without a name, it is a thread.
"""

import contextlib
import ctypes
import os
import signal
import subprocess
from collections.abc import Callable, Mapping
from importlib import import_module
from multiprocessing.connection import Connection, Pipe
from threading import Thread
from typing import Any

from drivers.child_process import start
from hil.record.ring import Ring


class RecorderEnd:
    """A started recorder, as its producer sees it. State: the link, the process or thread."""

    def __init__(self, ring: Ring) -> None:
        """Start the recorder; a process inherits the memory of the ring and its end of the link."""
        self._link, other = Pipe()
        self.process: subprocess.Popen[bytes] | None = None
        if ring.fd < 0:
            record: Any = import_module("hil.record.recorder").record  # that module imports this one
            self._thread = Thread(target=record, args=(other, lambda *_: ring), daemon=True)
            self._thread.start()
            return
        # Ctrl-C must not end a recorder that starts: it inherits the mask and clears it when it is ready
        held = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, held)
        try:
            self.process = start(
                "hil.record.recorder",
                *map(str, (ring.fd, other.fileno(), os.getpid())),
                environment={"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=(ring.fd, other.fileno()),
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            other.close()

    @property
    def alive(self) -> bool:
        """True while the recorder runs."""
        return self._thread.is_alive() if self.process is None else self.process.poll() is None

    def send(self, message: Mapping[str, Any]) -> None:
        """Send the recorder its set-up, or at the end the summary. Raises OSError if it has ended."""
        self._link.send(message)

    def answer(self, timeout_s: float) -> dict[str, Any]:
        """Next answer of the recorder; {} if it has ended, an `error` entry after `timeout_s`."""
        with contextlib.suppress(OSError):  # the other end is closed
            if not self._link.poll(timeout_s):
                return {"error": f"the recorder did not answer within {timeout_s:g} s"}
        return receive(self._link) or {}

    def finish(self) -> None:
        """Close the link to the recorder and wait up to 5 s until it has ended."""
        self._link.close()
        if self.process is None:
            self._thread.join(5.0)
        else:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(5.0)


def receive(link: "Connection[Any, Any]") -> dict[str, Any] | None:
    """Next message (a dictionary) from the other end of a link; None if that end is closed."""
    try:
        message: dict[str, Any] = link.recv()
    except (EOFError, OSError):
        return None
    return message


def loaded(name: str, code: bytes) -> Callable[..., int]:
    """Load a compiled function of C-contiguous arrays from its machine code, 0.2 s faster than by Numba."""
    from llvmlite import binding  # noqa: PLC0415 - 20 ms

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    target = binding.Target.from_default_triple().create_target_machine(jit=True)
    engine = binding.create_mcjit_compiler(binding.parse_assembly(""), target)
    engine.add_object_file(binding.ObjectFileRef.from_data(code))
    engine.finalize_object()
    function = ctypes.CFUNCTYPE(ctypes.c_int32)(engine.get_function_address(name))

    def call(*arrays: Any, _engine: object = engine) -> int:
        return int(function(*[ctypes.c_void_p(array.ctypes.data) for array in arrays]))

    return call
