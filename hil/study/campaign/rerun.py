"""`hil campaign rerun FILE ROW`: runs one row again and compares its metrics with the stored row."""

from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import ConfigurationError, LogError
from hil.app.output import log_path
from hil.app.sim.command import simulate
from hil.record.log import Log
from hil.study.campaign import parquet
from hil.study.campaign.command import line
from hil.study.campaign.figures import METRICS, Measurement
from hil.study.campaign.plan import Plan, identity
from hil.study.campaign.row import Ended, Job, outcome, performed, row_configuration
from hil.study.campaign.store import stored_rows
from plant_fmu.faults.plan import FaultPlan


def rerun(plan: Plan, out: Path | None, number: int, log: Path | None) -> dict[str, Any]:
    """Run a row again; return the summary (key `success`: bit-identical metrics).

    out : folder of the campaign's results, None: the default folder. log : file to record, `Path()`: a new
    name next to the other logs; None: no recording.

    The metrics of the run, and of its log, are compared with the stored row; without a stored row, the log's
    with the run's. A row that is not stored can only be recorded, and only without `out`.

    Raises ConfigurationError: no such row, or the row has no run to record; LogError: the row is not stored,
    the folder belongs to another campaign, or the log exists.
    """
    parquet.require()
    if not 0 <= number < len(plan):
        raise ConfigurationError(f"row {number}: allowed: 0 to {len(plan) - 1}, the rows of {plan.path}")
    columns = parquet.columns(plan)
    folder = out or plan.folder
    stored = stored_rows(folder, identity(plan)).get(number)
    if stored is None and (out is not None or log is None):
        raise LogError(
            f"{folder}: row {number} of {plan.path} is not stored there; give the folder of its results with "
            "--out, run `hil campaign` first, or add --log without --out to record the row alone"
        )
    job = plan.job(number)
    if log is not None:
        log_folder = row_configuration(job).recording.folder
        log = log_path(log_folder, f"{plan.name}-row-{number}", None if log == Path() else log)
    again, ended = performed(job)
    row = line(again, columns)
    found = {"run again": row}
    if log is not None:
        if ended is None:
            raise ConfigurationError(f"row {number}: {again['trouble']}; it has no run to record")
        found["its log"] = line(_recorded(job, ended, log), columns)
    against = stored or row
    different = [
        f"{name} of {what}: {cells[name]!r}, {'stored' if stored else 'run again'}: {against[name]!r}"
        for what, cells in found.items()
        for name in cells
        if repr(cells[name]) != repr(against[name])  # to the bit
    ]
    return {
        "success": not different,
        "kind": "campaign_row",
        "trouble": f"the figures differ: {'; '.join(different)}" if different else None,
        "campaign": str(plan.path),
        "row": number,
        "values": {name: row[name] for name in job.values},
        "passed": row["passed"],
        "ended": row["ended"],
        "faults": row["faults"] or None,
        "metrics": {name: row[name] for name in METRICS},
        "compared_with": "the stored row" if stored else f"nothing: no row is stored in {folder}",
        "different": len(different) if stored or different else None,
        "log": None if log is None else str(log),
    }


def _recorded(job: Job, ended: Ended, log: Path) -> dict[str, Any]:
    """Record a row's run until the platform parks; return the row's outcome computed from the log."""
    c = row_configuration(job)
    rate = c.loop.rate_Hz
    stop_tick = ended.ticks if ended.stop_tick is None else ended.stop_tick
    chance = FaultPlan((), job.seed)
    simulate(c, log=log, duration_s=stop_tick / rate, faults=chance, plant_log=True, check_replay=False)
    measured = Measurement(travels=job.subject.settings.after_fault == "rest")
    recorded = Log(log)
    with np.errstate(all="ignore"):
        pairs = zip(recorded.rows(), recorded.plant.rows("length")["length"], strict=True)
        for row, length in islice(pairs, ended.ticks):
            measured.take(row, length)
    return outcome(job, rate, ended, measured)
