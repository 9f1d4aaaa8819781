"""`hil watch` as a child of `hil run --watch`: it prints its own link and leaves with the run."""

import os
import subprocess
from typing import Self

from drivers.child_process import start
from hil.app.configuration.configuration import Configuration

END_S = 5.0


class WatchProcess:
    """The live page in a process of its own, with a session of its own: Ctrl-C is for the run.

    It notices the end of the run by a pipe that is closed. Mutable state: process and pipe.
    """

    def __init__(self, c: Configuration) -> None:
        read, self._alive = os.pipe()
        self._process = start(
            "hil.cli", "watch", c.source, "--supervisor", str(read),
            pass_fds=(read,),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            start_new_session=True,
        )  # fmt: skip
        os.close(read)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        os.close(self._alive)
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
