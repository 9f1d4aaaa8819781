"""Rows on the workers of a Dask cluster: theirs are the processes, the machines and what becomes of them."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from importlib.metadata import version
from itertools import islice
from typing import Any

from drivers.errors import ConfigurationError
from hil.study.campaign.row import Job, not_run, run_row

WAIT_S = 10
"""For the scheduler to answer."""
_AHEAD = 4
"""Rows for each worker's thread that are under way at once: its next one waits there."""
_COUNT_EVERY_S = 1.0
"""Workers come and go; how many there are is asked that often."""
Outcome = dict[str, Any]


def perform(
    address: str, work: Sequence[Job], progress: Callable[[int, int], None] | None
) -> Iterator[Outcome]:
    """Yield the outcome of every row, in the order in which they are ready; progress comes before each.

    The workers need this version of the product and the files that the configuration names, at the same
    paths. Rows wait while there is no worker. Rows whose workers died again and again run once more in the
    end, alone: the one that did it has `died`.

    Raises ConfigurationError: Dask is not installed, nobody answers at `address`, the scheduler goes away, or
    a worker cannot run rows.
    """
    try:
        from distributed import Client  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise ConfigurationError(
            f'--scheduler needs Dask, which is not installed ({error}): pip install "hexapod-hil[dask]"; '
            "without --scheduler the rows run on this machine"
        ) from error
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # tracebacks of what is said below
    try:
        client = Client(address, timeout=WAIT_S, set_as_default=False)
    except (OSError, TypeError, ValueError, TimeoutError) as error:  # TypeError: tls:// without certificates
        raise ConfigurationError(
            f"--scheduler {address}: no scheduler answers within {WAIT_S} s ({error}); allowed: the address "
            "that `dask scheduler` prints, as tcp://10.0.0.5:8786"
        ) from None
    with client:
        outcomes = _outcomes(client, address, iter(work))
        for n in range(len(work)):
            if progress is not None:
                progress(n, len(work))
            try:
                outcome = next(outcomes)
            except (CancelledError, OSError) as error:
                why = " ".join(str(error).split())  # one line: Dask's has several
                raise ConfigurationError(
                    f"--scheduler {address}: it is gone, or has dropped rows ({why}); once it is back the "
                    "same command goes on with the rows that are missing"
                ) from None
            yield outcome


def run_at_worker(job: Job, wanted: str) -> Outcome | str:
    """Run a row at a worker; return its outcome, or why this worker can run none.

    Nothing is raised: a traceback that cannot be pickled ends the error on its way, and the client waits.
    """
    here = version("hexapod-hil")
    if here != wanted:
        return f"it has hexapod-hil {here}, allowed: {wanted}, as here"
    try:
        return run_row(job)
    except ConfigurationError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001 - see above
        return f"row {job.number}: {type(error).__name__}: {error}"


def _outcomes(client: Any, address: str, jobs: Iterator[Job]) -> Iterator[Outcome]:
    """Yield the outcomes of all jobs. Raises as `_until_lost`."""
    lost: list[Job] = []
    yield from _until_lost(client, address, jobs, _Room(client), lost)
    for job in lost:
        again: list[Job] = []
        yield from _until_lost(client, address, iter([job]), lambda: 1, again)
        if again:
            yield not_run(job)


class _Room:
    """How many rows may be under way. Mutable state: how many workers' threads there were when last asked."""

    def __init__(self, client: Any) -> None:
        self._client, self._asked, self._threads = client, -_COUNT_EVERY_S, 0

    def __call__(self) -> int:
        if time.monotonic() - self._asked >= _COUNT_EVERY_S:
            self._threads = sum(self._client.nthreads().values())
            self._asked = time.monotonic()
        return _AHEAD * max(1, self._threads)


def _until_lost(
    client: Any, address: str, jobs: Iterator[Job], room: Callable[[], int], lost: list[Job]
) -> Iterator[Outcome]:
    """Yield the outcomes of jobs; `lost` gets those that were at too many workers that died.

    Raises ConfigurationError; CancelledError, OSError: the scheduler is gone.
    """
    from distributed import as_completed  # noqa: PLC0415 - an extra
    from distributed.scheduler import KilledWorker  # noqa: PLC0415

    wanted = version("hexapod-hil")
    waiting: dict[Any, Job] = {}
    futures = as_completed(loop=client.loop)
    while True:
        for job in islice(jobs, max(0, room() - len(waiting))):
            # not pure: Dask is not to look for it among the results that it keeps
            submitted = client.submit(run_at_worker, job, wanted, pure=False)
            waiting[submitted] = job
            futures.add(submitted)
        if not waiting:
            return
        future = next(futures)
        job = waiting.pop(future)
        try:
            found = future.result()
        except KilledWorker:
            lost.append(job)
            continue
        except (CancelledError, OSError):  # the scheduler's: nothing that a row raises comes this way
            raise
        except Exception as error:
            raise ConfigurationError(
                f"--scheduler {address}: a worker cannot run row {job.number}: {error!r}; allowed: "
                "workers with the same versions of Python and hexapod-hil as here"
            ) from error
        if isinstance(found, str):
            raise ConfigurationError(f"--scheduler {address}: at a worker: {found}")
        yield found
