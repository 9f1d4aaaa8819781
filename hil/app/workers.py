"""Jobs in processes of their own."""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.forkserver import ensure_running
from multiprocessing.resource_tracker import ensure_running as ensure_tracker
from threading import Thread
from typing import TypeVar

Job = TypeVar("Job")
Outcome = TypeVar("Outcome")
Progress = Callable[[int, int], None]
"""Called with how many jobs are done, and of how many."""


def perform(
    work: Sequence[Job],
    function: Callable[[Job], Outcome],
    died: Callable[[Job], Outcome],
    jobs: int | None,
    progress: Progress | None,
) -> Iterator[Outcome]:
    """Yield the outcome of every job, in the order in which they are ready; progress comes before each.

    function : of a module that a fresh interpreter imports; died : what is the outcome of a job whose process
    dies; jobs : processes at once, default one a processor; 1 is this process.
    """
    count = min(len(work), jobs or len(os.sched_getaffinity(0)))
    outcomes = map(function, work) if count <= 1 else _in_processes(work, function, died, count)
    for n in range(len(work)):
        if progress is not None:
            progress(n, len(work))
        yield next(outcomes)


def _in_processes(
    work: Sequence[Job], function: Callable[[Job], Outcome], died: Callable[[Job], Outcome], count: int
) -> Iterator[Outcome]:
    """Yield every outcome of `count` processes; if one dies, the lost jobs run again, each by itself."""
    lost = []
    with _pool(count, function) as pool:
        try:
            with _undisturbed():
                waiting = {pool.submit(function, job): job for job in work}
            for future in as_completed(waiting):
                try:
                    yield future.result()
                except BrokenProcessPool:
                    lost.append(waiting[future])
                del waiting[future]  # its outcome is the caller's; of a hundred thousand none is kept
        except BaseException:
            for process in active_children():  # they would finish their jobs first, for nobody
                process.kill()
            pool.shutdown(cancel_futures=True)
            raise
    for job in lost:
        with _pool(1, function) as pool:
            try:
                yield pool.submit(function, job).result()
            except BrokenProcessPool:
                yield died(job)


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

    They inherit that. A terminal sends Ctrl-C to all, and it is for this process alone, which ends them.
    """
    ensure_tracker()  # started later it would let Ctrl-C through
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
