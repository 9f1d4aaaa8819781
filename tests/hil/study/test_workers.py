"""Jobs in processes: each has one outcome, whichever process dies, and none is made long in advance."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from operator import call

import pytest

from hil.study.workers import AHEAD, perform
from tests.realtime.rig import wait_until_gone


class Work(list):  # type: ignore[type-arg]
    """Jobs, and a count of how many were taken."""

    made = 0

    def __iter__(self):
        for job in super().__iter__():
            self.made += 1
            yield job


def test_death_of_a_worker_process_repeats_few_jobs_and_jobs_are_created_only_when_due():
    work = Work([os.getpid] * 40)
    work[5] = partial(os._exit, 1)
    outcomes = perform(work, call, lambda _: "died", 2, None)
    found = [next(outcomes)]
    assert work.made <= 2 * AHEAD + 1
    found += outcomes
    assert len(found) == 40
    assert found.count("died") == 1
    alone = 2 * AHEAD  # as many as were under way
    assert len(set(found)) <= 2 + alone + 2


LONG = """
import os, time
from functools import partial
from operator import call
from hil.study.workers import perform
from hil.cli.interrupts import attached

with attached():
    for found in perform([os.getpid] * 8 + [partial(time.sleep, 100.0)] * 4, call, str, 2, None):
        print(found, flush=True)
"""
"""Prints its workers' process numbers, and lets them sleep."""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_workers_end_when_their_parent_dies_in_the_middle_of_jobs(how):
    with subprocess.Popen(
        [sys.executable, "-c", LONG], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdout is not None
        workers = {int(process.stdout.readline()) for _ in range(8)}
        while process.poll() is None:
            process.send_signal(how)  # again and again: Python drops a press in a finalizer
            time.sleep(0.2)
        wait_until_gone(process.pid, *workers)
    assert process.returncode != 0


def test_a_single_job_runs_in_a_separate_process_unless_jobs_is_1():
    """A crashing job in this process would end the command."""
    (found,) = perform([os.getpid], call, str, None, None)
    assert found != os.getpid()
    assert list(perform([partial(os._exit, 1)], call, lambda _: "died", None, None)) == ["died"]
    assert list(perform([os.getpid], call, str, 1, None)) == [os.getpid()]
