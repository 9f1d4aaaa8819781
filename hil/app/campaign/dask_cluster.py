"""Rows on the workers of a Dask cluster: theirs are the processes, the machines and what becomes of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from drivers.errors import ConfigurationError
from hil.app.campaign.row import Job, not_run, run_row

WAIT_S = 10
"""For the scheduler to answer."""
_AHEAD = 4
"""Rows for each worker's thread that are under way at once: its next one waits there."""
Outcome = dict[str, Any]


def perform(
    address: str, work: Sequence[Job], progress: Callable[[int, int], None] | None
) -> Iterator[Outcome]:
    """Yield the outcome of every row, in the order in which they are ready; progress comes before each.

    The workers need this version of the product and the files that the configuration names, at the same
    paths. A row whose worker dies again and again has `died`.

    Raises ConfigurationError: Dask is not installed, or nobody answers at `address`.
    """
    try:
        from distributed import Client, as_completed  # noqa: PLC0415 - an extra
        from distributed.scheduler import KilledWorker  # noqa: PLC0415
    except ImportError as error:
        raise ConfigurationError(
            f'--scheduler needs Dask, which is not installed ({error}): pip install "hexapod-hil[dask]"; '
            "without --scheduler the rows run on this machine"
        ) from error
    try:
        client = Client(address, timeout=WAIT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise ConfigurationError(
            f"--scheduler {address}: no scheduler answers within {WAIT_S} s ({error}); allowed: the address "
            "that `dask scheduler` prints, as tcp://10.0.0.5:8786"
        ) from None
    with client:
        ahead = _AHEAD * max(1, sum(client.nthreads().values()))
        jobs = iter(work)
        waiting = {_submit(client, job): job for _, job in zip(range(ahead), jobs, strict=False)}
        futures = as_completed(waiting, loop=client.loop)
        for n in range(len(work)):
            if progress is not None:
                progress(n, len(work))
            future = next(futures)
            job = waiting.pop(future)
            try:
                found = future.result()
            except KilledWorker as error:
                found = not_run(job, why=f"its workers died: {error}")
            except ConfigurationError as error:
                raise ConfigurationError(f"--scheduler {address}: at a worker: {error}") from error
            except Exception as error:  # `run_row` raises little else: it is the cluster
                raise ConfigurationError(
                    f"--scheduler {address}: a worker cannot run row {job.number}: {error!r}; allowed: "
                    "workers with the same versions of Python and hexapod-hil as here"
                ) from error
            following = next(jobs, None)
            if following is not None:
                submitted = _submit(client, following)
                waiting[submitted] = following
                futures.add(submitted)
            yield found


def _submit(client: Any, job: Job) -> Any:
    """Hand a row to the cluster; not pure: Dask is not to look for it among the results that it keeps."""
    return client.submit(run_row, job, pure=False, key=f"campaign-row-{job.number}-{id(job)}")
