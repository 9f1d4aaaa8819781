"""Runs campaign rows on the workers of a Dask cluster, which manages processes, machines and failures."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from contextlib import nullcontext
from functools import partial
from importlib.metadata import version
from typing import Any

from drivers.errors import ConfigurationError
from hil.study.campaign.row import Job, not_run, run_row
from hil.study.workers import Progress, batch, counted

WAIT_S = 10
"""Timeout for the scheduler's answer."""
AHEAD = 1000
"""Rows submitted to the cluster at once."""
Outcome = dict[str, Any]


def perform(address: str, work: Iterable[Job], total: int, progress: Progress | None) -> Iterator[Outcome]:
    """Run `total` rows on a Dask cluster; yield outcomes in order of completion.

    `progress` is called before each outcome. The workers need this version of the product, and the files that
    the configuration names at the same paths. Rows wait while there is no worker. Rows whose workers died
    repeatedly run once more, one at a time; a row whose worker dies again ends as `died`.

    Raises ConfigurationError: Dask is not installed, nothing answers at `address`, the scheduler is lost, or
    a worker cannot run rows.
    """
    try:
        from distributed import Client  # noqa: PLC0415 - an extra
        from distributed.scheduler import KilledWorker  # noqa: PLC0415
    except ImportError as error:
        raise ConfigurationError(
            f'--scheduler needs Dask, which is not installed ({error}): pip install "hexapod-hil[dask]"; '
            "without --scheduler the rows run on this machine"
        ) from error
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # tracebacks of what is reported below
    here = version("hexapod-hil")
    try:
        with Client(address, timeout=WAIT_S, set_as_default=False) as client:
            # not pure: Dask must not reuse a stored result for a row
            executor = client.get_executor(pure=False)
            function = partial(run_at_worker, wanted=here)
            outcomes = batch(work, function, not_run, lambda _: nullcontext(executor), AHEAD, KilledWorker)
            yield from map(_outcome, counted(outcomes, total, progress))
    except Exception as error:
        why = " ".join(str(error).split()) or repr(error)
        raise ConfigurationError(
            f"--scheduler {address}: {why}; allowed: the address that `dask scheduler` prints, as "
            f"tcp://10.0.0.5:8786, with workers of the same Python and hexapod-hil ({here}); the same "
            "command continues with the missing rows"
        ) from error


def _outcome(found: Outcome | str) -> Outcome:
    if isinstance(found, str):
        raise ConfigurationError(f"at a worker: {found}")
    return found


def run_at_worker(job: Job, wanted: str) -> Outcome | str:
    """Run a row on a worker; return its outcome, or the reason why this worker cannot run rows.

    Nothing is raised: an error with a traceback that cannot be pickled would never reach the waiting client.
    """
    here = version("hexapod-hil")
    if here != wanted:
        return f"it has hexapod-hil {here}, allowed: {wanted}, the client's version"
    try:
        return run_row(job)
    except ConfigurationError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001 - see above
        return f"row {job.number}: {type(error).__name__}: {error}"
