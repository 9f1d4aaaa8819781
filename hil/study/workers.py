"""Jobs in processes of their own."""

import os
import resource
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.forkserver import ensure_running
from multiprocessing.resource_tracker import ensure_running as ensure_tracker
from threading import Thread
from typing import TypeVar

from drivers.errors import RunError

Job = TypeVar("Job")
Outcome = TypeVar("Outcome")
Progress = Callable[[int, int], None]
"""Called with how many jobs are done, and of how many."""
FILES_HERE, FILES_EACH = 32, 2
"""Open files of this process: of its command and what lends processes, and of each of those."""
AHEAD = 4
"""Jobs for each process that are under way at once: the next one is there when the last one is done."""


def perform(
    work: Sequence[Job],
    function: Callable[[Job], Outcome],
    died: Callable[[Job], Outcome],
    jobs: int | None,
    progress: Progress | None,
) -> Iterator[Outcome]:
    """Yield the outcome of every job, in the order in which they are ready; progress comes before each.

    function : of a module that a fresh interpreter imports; died : what is the outcome of a job whose process
    dies; jobs : processes at once, default one a processor; 1 is this process, where a job that crashes takes
    the command with it. Raises RunError where so many may not open their files.
    """
    count = min(len(work), jobs or len(os.sched_getaffinity(0)))
    outcomes = map(function, work) if jobs == 1 else _in_processes(work, function, died, count)
    for n in range(len(work)):
        if progress is not None:
            progress(n, len(work))
        yield next(outcomes)


def _require_files(count: int) -> None:
    needed = FILES_HERE + FILES_EACH * count
    most, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if most != resource.RLIM_INFINITY and most < needed:
        raise RunError(
            f"{count} processes at once need {needed} open files, allowed here: {most}; "
            "raise `ulimit -n`, or work in one: --jobs 1"
        )


def _in_processes(
    work: Sequence[Job], function: Callable[[Job], Outcome], died: Callable[[Job], Outcome], count: int
) -> Iterator[Outcome]:
    """Yield every outcome of `count` processes; the jobs that were under way when one died run again, alone.

    Only some jobs are under way at once: of a million none is made before its turn, and a process that dies
    takes few with it. The others go on in new processes.
    """
    _require_files(count)
    rest = iter(work)
    while True:
        lost: list[Job] = []
        with _processes(count, function) as pool:
            yield from _until_one_dies(pool, rest, function, AHEAD * count, lost)
        if not lost:
            return
        for job in lost:
            with _processes(1, function) as pool:
                try:
                    yield pool.submit(function, job).result()
                except BrokenProcessPool:
                    yield died(job)


@contextmanager
def _processes(count: int, function: Callable[[Job], Outcome]) -> Iterator[ProcessPoolExecutor]:
    """Lend processes that end at once where anything fails: they would finish jobs first, for nobody."""
    with _pool(count, function) as pool:
        try:
            yield pool
        except BaseException:
            for process in active_children():
                process.kill()
            pool.shutdown(cancel_futures=True)
            raise


def _until_one_dies(
    pool: ProcessPoolExecutor,
    rest: Iterator[Job],
    function: Callable[[Job], Outcome],
    ahead: int,
    lost: list[Job],
) -> Iterator[Outcome]:
    """Yield outcomes of jobs from `rest`, until it is empty or a process dies; `lost` gets what that took."""
    waiting: dict[Future[Outcome], Job] = {}
    broken = False
    while True:
        for job in () if broken else islice(rest, ahead - len(waiting)):
            try:
                with _undisturbed():
                    waiting[pool.submit(function, job)] = job
            except BrokenProcessPool:
                lost.append(job)
                broken = True
                break
        if not waiting:
            return
        for future in wait(waiting, return_when=FIRST_COMPLETED).done:
            job = waiting.pop(future)
            try:
                yield future.result()
            except BrokenProcessPool:
                lost.append(job)
                broken = True


def _pool(count: int, function: Callable[[Job], Outcome]) -> ProcessPoolExecutor:
    """Return processes forked from a fresh interpreter: forked from this one they would hold its locks."""
    context = get_context("forkserver")
    context.set_forkserver_preload([function.__module__])
    with _undisturbed():
        ensure_running()
    return ProcessPoolExecutor(count, mp_context=context, initializer=_end_with_parent)


def _end_with_parent() -> None:
    """Let this process end when its parent does, by whatever signal: it would wait for jobs for good."""
    Thread(target=_await_parent, daemon=True).start()


def _await_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Let Ctrl-C wait while processes are started: one that is half started could not be ended.

    And the timer that repeats one. They inherit that. A terminal sends Ctrl-C to all, and it is for this
    process alone, which ends them.
    """
    ensure_tracker()  # started later it would let Ctrl-C through
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGALRM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
