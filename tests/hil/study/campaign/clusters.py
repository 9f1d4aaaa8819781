"""A Dask scheduler and its workers as separate processes on the loopback."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress

from tests.hil.study.campaign.campaigns import ROOT

START_S = 200.0
"""Timeout for starting an interpreter, Dask and a handshake, on a busy machine."""


class Cluster:
    """Mutable state: the started processes, which `close` ends."""

    def __init__(self, folder):
        self.folder = folder
        self.scheduler, self.workers = None, []
        self.address = ""

    def start(self, workers, *words, preload=None):
        """Start the scheduler and its workers, each a single process of one thread."""
        self.scheduler = self._start(
            "scheduler", "distributed.cli.dask_scheduler", "--port", "0", "--no-show"
        )
        self.address = self._said("scheduler", "Scheduler at:").split()[-1]
        for _ in range(workers):
            self.add(*words, preload=preload)
        return self

    def add(self, *words, preload=None):
        """Start a worker, and wait until it has registered at the scheduler."""
        name = f"worker{len(self.workers)}"
        loaded = [] if preload is None else ["--preload", str(preload)]
        worker = self._start(
            name, "distributed.cli.dask_worker", self.address, "--nthreads", "1", *(words or ("--no-nanny",)),
            *loaded, "--local-directory", str(self.folder / name),
        )  # fmt: skip
        self.workers.append(worker)
        self._said(name, "Registered to:")
        return worker

    def close(self):
        """End the remaining processes, children included."""
        for process in filter(None, (*self.workers, self.scheduler)):
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()

    def _start(self, name, module, *words):
        with (self.folder / f"{name}.log").open("wb") as log:
            return subprocess.Popen(
                [sys.executable, "-m", module, *words, "--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0"],
                cwd=self.folder, env=os.environ | {"PYTHONPATH": str(ROOT)},
                stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip

    def _said(self, name, words):
        """First output line of a process that contains these words."""
        end = time.monotonic() + START_S
        while time.monotonic() < end:
            lines = (self.folder / f"{name}.log").read_text().splitlines()
            if found := next((line for line in lines if words in line), None):
                return found
            time.sleep(0.05)
        raise AssertionError("\n".join(lines))


@contextmanager
def cluster(folder, workers, *words, preload=None):
    """Yield a running cluster. words : options of each worker (default --no-nanny: not restarted)."""
    running = Cluster(folder)
    try:
        yield running.start(workers, *words, preload=preload)
    finally:
        running.close()
