"""Jobs of one function in processes of their own, or wherever else an executor has them done."""

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
"""Called with how many jobs are done, and of how many."""
Lend = Callable[[int], AbstractContextManager[Executor]]
"""Lends an executor for N jobs at once."""
AHEAD = 4
"""Jobs for each process that are under way at once: the next one is there when the last one is done."""


def perform(
    work: Iterable[Job],
    function: Callable[[Job], Outcome],
    died: Callable[[Job], Outcome],
    jobs: int | None,
    progress: Progress | None,
    total: int | None = None,
) -> Iterator[Outcome]:
    """Yield the outcome of every job, in the order in which they are ready; progress comes before each.

    function : of a module that a fresh interpreter imports; died : the outcome of a job whose process dies;
    jobs : processes at once, default one a processor; 1 is this process, where a job that crashes takes the
    command with it; total : how many jobs there are, where they are made one by one.
    """
    if total is None:
        assert isinstance(work, Sized)
        total = len(work)
    count = min(total, jobs or len(os.sched_getaffinity(0)))
    outcomes: Iterator[Outcome] = map(function, work)
    if jobs != 1:
        lend: Lend = lambda most: processes(min(most, count), function)  # noqa: E731
        outcomes = batch(work, function, died, lend, AHEAD * count, BrokenProcessPool)
    return counted(outcomes, total, progress)


def counted(outcomes: Iterator[Outcome], total: int, progress: Progress | None) -> Iterator[Outcome]:
    """Yield `total` outcomes; progress comes before each."""
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
    gone: type[BaseException],
) -> Iterator[Outcome]:
    """Yield the outcome of every job. Those lost with a process that died run again, each alone.

    At most `ahead` jobs are under way at once: of a million none is made before its turn, and a process that
    dies takes few with it. gone : what the future of a job raises that was lost. Other exceptions go on.
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
                    except gone:
                        lost.append(job)
                if not waiting:
                    break
                for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                    job = waiting.pop(future)
                    try:
                        yield future.result()
                    except gone:
                        lost.append(job)
        if not lost:
            return
        for job in lost:
            with lend(1) as executor:
                try:
                    yield executor.submit(function, job).result()
                except gone:
                    yield died(job)
        lost.clear()


@contextmanager
def processes(count: int, function: Callable[[Job], Outcome]) -> Iterator[ProcessPoolExecutor]:
    """Lend processes that end at once where anything fails: they would finish jobs first, for nobody.

    They are forked from a fresh interpreter: forked from this one they would hold its locks. A terminal sends
    Ctrl-C to all of them; it is for this process alone, which ends them.
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
    """Let this process end when its parent does, by whatever signal: it would wait for jobs for good."""
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    Thread(target=watch, daemon=True).start()
