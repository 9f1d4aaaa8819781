"""Recorder as a child process: start it, send its set-up, receive its answers, wait for its end."""

import contextlib
import ctypes
import os
import pickle
import select
import signal
import subprocess
from collections.abc import Callable, Mapping
from typing import IO, Any

from drivers.child_process import start
from hil.record.ring import Ring
from hil.record.thread import RecorderThread

RecorderEnd = subprocess.Popen[bytes] | RecorderThread


def spawn(ring: Ring) -> RecorderEnd:
    """Start the recorder: a process, which inherits the memory of the ring and two pipes, or a thread."""
    if ring.fd < 0:
        return RecorderThread(ring)
    # Ctrl-C must not end the recorder while it starts: it inherits the mask and clears it when it is ready
    held = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, held)
    try:
        return start(
            "hil.record",
            str(ring.fd),
            str(os.getpid()),
            environment={"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=(ring.fd,),
        )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def send(process: RecorderEnd, message: Mapping[str, Any]) -> None:
    """Send the recorder its set-up, or at the end the summary. Raises OSError if it has ended."""
    if isinstance(process, RecorderThread):
        process.inbox.put(message)
        return
    assert process.stdin is not None
    process.stdin.write(pickle.dumps(message))
    process.stdin.flush()


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


def answer(process: RecorderEnd, timeout_s: float) -> dict[str, Any]:
    """Next answer of the recorder; {} if it has ended, an `error` entry after `timeout_s`."""
    if isinstance(process, RecorderThread):
        return process.answer(timeout_s)
    assert process.stdout is not None
    if not select.select([process.stdout], [], [], timeout_s)[0]:
        return {"error": f"the recorder did not answer within {timeout_s:g} s"}
    return receive(process.stdout) or {}


def receive(pipe: IO[bytes]) -> dict[str, Any] | None:
    """Next message (a dictionary) from the other end of a pipe; None if that end is closed."""
    try:
        message: dict[str, Any] = pickle.load(pipe)  # noqa: S301 - of our own process
    except (EOFError, pickle.UnpicklingError):
        return None
    return message


def finish(process: RecorderEnd) -> None:
    """Close the pipes to the recorder and wait up to 5 s until it has ended."""
    if isinstance(process, RecorderThread):
        process.finish()
        return
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with contextlib.suppress(OSError):
                pipe.close()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(5.0)
