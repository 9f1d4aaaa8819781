"""Runs one function on many jobs, in separate processes or on another executor."""

import os
import signal
from collections.abc import Callable, Iterable, Iterator, Sized
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from itertools import islice
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.forkserver import ensure_running
from multiprocessing.resource_tracker import ensure_running as ensure_tracker
from threading import Thread
from typing import TypeVar

Job = TypeVar("Job")
Outcome = TypeVar("Outcome")
Progress = Callable[[int, int], None]
"""Called with the number of finished jobs and the number of all jobs."""
Lend = Callable[[int], AbstractContextManager[Executor]]
"""Provides an executor for N jobs at once."""
AHEAD = 4
"""Jobs submitted at once per process, so that no process waits for its next job."""


def perform(
    work: Iterable[Job],
    function: Callable[[Job], Outcome],
    died: Callable[[Job], Outcome],
    jobs: int | None,
    progress: Progress | None,
    total: int | None = None,
) -> Iterator[Outcome]:
    """Run `function` on every job; yield outcomes in the order of completion.

    function : in a module that a fresh interpreter can import. died : outcome of a job whose process dies.
    jobs : number of processes, default one per processor; 1 runs the jobs in this process, where a crash ends
    the command. progress : called before each outcome. total : number of jobs, if `work` is an iterator.
    """
    if total is None:
        assert isinstance(work, Sized)
        total = len(work)
    if not hasattr(os, "sched_getaffinity"):
        jobs = 1  # the processes of a pool need Linux
    count = min(total, jobs or len(os.sched_getaffinity(0)))
    outcomes: Iterator[Outcome] = map(function, work)
    if jobs != 1:
        lend: Lend = lambda most: processes(min(most, count), function)  # noqa: E731
        outcomes = batch(work, function, died, lend, AHEAD * count, BrokenProcessPool)
    return counted(outcomes, total, progress)


def counted(outcomes: Iterator[Outcome], total: int, progress: Progress | None) -> Iterator[Outcome]:
    """Yield `total` outcomes; before each, `progress` is called with the number finished and `total`."""
    for n in range(total):
        if progress is not None:
            progress(n, total)
        yield next(outcomes)


def batch(
    work: Iterable[Job],
    function: Callable[[Job], Outcome],
    died: Callable[[Job], Outcome],
    lend: Lend,
    ahead: int,
    lost_error: type[BaseException],
) -> Iterator[Outcome]:
    """Run `function` on every job in an executor; yield outcomes. Lost jobs run again, one at a time.

    At most `ahead` jobs are submitted at once: a million jobs are not made in advance, and a dead process
    loses few. died : outcome of a job lost twice. lost_error : exception of a lost job. Others propagate.
    """
    rest = iter(work)
    lost: list[Job] = []
    while True:
        with lend(ahead) as executor:
            waiting: dict[Future[Outcome], Job] = {}
            while True:
                for job in islice(rest, 0 if lost else ahead - len(waiting)):
                    try:
                        waiting[executor.submit(function, job)] = job
                    except lost_error:
                        lost.append(job)
                if not waiting:
                    break
                for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                    job = waiting.pop(future)
                    try:
                        yield future.result()
                    except lost_error:
                        lost.append(job)
        if not lost:
            return
        for job in lost:
            with lend(1) as executor:
                try:
                    yield executor.submit(function, job).result()
                except lost_error:
                    yield died(job)
        lost.clear()


@contextmanager
def processes(count: int, function: Callable[[Job], Outcome]) -> Iterator[ProcessPoolExecutor]:
    """Pool of `count` processes that are killed at once if anything fails, instead of finishing their jobs.

    They are forked from a fresh interpreter, so that they hold no locks of this one. They block Ctrl-C, which
    a terminal sends to all of them: this process handles it and ends them.
    """
    context = get_context("forkserver")
    context.set_forkserver_preload([function.__module__])
    ensure_tracker()  # started later it would let Ctrl-C through
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # all processes inherit that
    try:
        ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    with ProcessPoolExecutor(count, mp_context=context, initializer=_end_with_parent) as pool:
        try:
            yield pool
        except BaseException:
            for process in active_children():
                process.kill()
            pool.shutdown(cancel_futures=True)
            raise


def _end_with_parent() -> None:
    """End this process when its parent dies, however it dies; otherwise it would wait for jobs forever."""
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    Thread(target=watch, daemon=True).start()
