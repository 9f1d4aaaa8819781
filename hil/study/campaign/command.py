"""`hil campaign FILE`: runs the rows still missing, writes the table, reports the failure rate."""

import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from hil.app.output import leaving
from hil.study.arrow import Column
from hil.study.campaign import dask_cluster, parquet
from hil.study.campaign.parquet import Row, cell
from hil.study.campaign.plan import Plan, identity
from hil.study.campaign.rates import rate
from hil.study.campaign.row import not_run, run_row
from hil.study.campaign.store import Store
from hil.study.workers import Progress, perform


def run_campaign(
    plan: Plan,
    folder: Path,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    fresh: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run the rows missing in `folder`; return the summary (key `success`: all rows passed).

    jobs : number of processes; default one per processor, 1: this process. scheduler : address of a Dask
    cluster that runs the rows instead. fresh : discard stored rows. An interruption keeps finished rows.

    Raises LogError: the folder belongs to another campaign, is in use or cannot be written, or pyarrow is not
    installed; ConfigurationError: the cluster does not answer, or a file that a row reads has changed.
    """
    parquet.require()
    begun = time.perf_counter()
    columns = parquet.columns(plan)
    with closing(Store(folder, columns, identity(plan), fresh=fresh)) as store:
        rows = store.rows()
        missing = [number for number in range(len(plan)) if number not in rows]
        kept = len(rows)

        def there() -> str:
            return f"with {len(rows)} of {len(plan)} rows in {folder}; the same command continues from there"

        def of_all(done: int, of: int) -> None:
            if progress is not None:
                progress(kept + done, kept + of)

        work = map(plan.job, missing)
        if scheduler is not None and missing:
            outcomes = dask_cluster.perform(scheduler, work, len(missing), of_all)
        else:
            outcomes = perform(work, run_row, not_run, jobs, of_all, len(missing))
        with leaving(there):
            for outcome in outcomes:
                row = line(outcome, columns)
                rows[row["row"]] = row
                store.add(row)
            table = store.finish(rows)
    ordered = [rows[number] for number in sorted(rows)]
    whole = rate("all", ordered)
    took = time.perf_counter() - begun
    return {
        "success": whole.passed == whole.rows,
        "kind": "campaign",
        "campaign": str(plan.path),
        "name": plan.name,
        "rows": whole.rows,
        "failed": whole.rows - whole.passed,
        "failed_percent": 100.0 * (1.0 - whole.passed / whole.rows),
        "failed_interval_percent": [100.0 * (1.0 - whole.high), 100.0 * (1.0 - whole.low)],
        "rows_kept": kept,
        "rows_run": len(missing),
        "rows_per_second": len(missing) / took if missing else None,
        "table": str(table),
        "matrix": ordered,
        "wall_s": took,
    }


def line(outcome: dict[str, Any], columns: Sequence[Column]) -> Row:
    """Table row of a campaign: axis values and outcome of a run, each converted to its column's type."""
    return {column.name: cell(column.kind, outcome[column.name]) for column in columns}
