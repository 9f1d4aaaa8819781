"""`hil campaign rerun FILE ROW`: one row again, and its figures compared to the bit."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError, LogError
from hil.app.configuration.configuration import Configuration
from hil.app.output import log_path
from hil.app.sim.command import simulate
from hil.record.log import Log
from hil.study.campaign import parquet
from hil.study.campaign.command import line
from hil.study.campaign.figures import METRICS, Measurement
from hil.study.campaign.plan import Plan, identity
from hil.study.campaign.row import Ended, Job, Ran, not_run, outcome, performed, row_configuration
from hil.study.campaign.store import stored_rows
from plant_fmu.faults.plan import FaultPlan


def rerun(plan: Plan, out: Path | None, number: int, log: Path | None) -> dict[str, Any]:
    """Run a row again, and return the summary (key `success`: the same figures to the bit).

    out : the campaign's results, None: the default place.
    log : where to record it, too, `Path()`: under a new name beside the other logs; None: nowhere.

    What is compared: with the row that is stored; the run without a log with that from its log. Where no row
    is stored, only what is recorded runs, and at the default place alone.

    Raises ConfigurationError: no such row, or one that has no run to record; LogError: no such row is stored,
    other campaign, log exists.
    """
    parquet.require()
    if not 0 <= number < len(plan):
        raise ConfigurationError(f"row {number}: allowed: 0 to {len(plan) - 1}, the rows of {plan.path}")
    columns = parquet.columns(plan)
    folder = out or plan.folder
    stored = stored_rows(folder, identity(plan)).get(number)
    if stored is None and (out is not None or log is None):
        raise _nothing_stored(plan, out, number)
    job = plan.job(number)
    if log is not None:
        log_folder = row_configuration(job).recording.folder
        log = log_path(log_folder, f"{plan.name}-row-{number}", None if log == Path() else log)
    again = performed(job)
    row = line(plan, again.outcome, columns)
    found = {"run again": row}
    if log is not None:
        if again.ended is None:
            raise ConfigurationError(f"row {number}: {again.outcome['trouble']}; it has no run to record")
        c = row_configuration(job)
        _simulate(c, job, again.ended, log)
        found["its log"] = line(plan, _from_log(c, job, again, log), columns)
    against = stored or row
    different = [
        f"{name} of {what}: {cells[name]!r}, {'stored' if stored else 'run again'}: {against[name]!r}"
        for what, cells in found.items()
        for name in cells
        if not _same(cells[name], against[name])
    ]
    return {
        "success": not different,
        "kind": "campaign_row",
        "trouble": None if not different else f"the figures differ: {'; '.join(different)}",
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


def _nothing_stored(plan: Plan, out: Path | None, number: int) -> LogError:
    """Return what is wrong with a row that would be compared with nothing."""
    where, mend = f"--out {out}", "name the folder of its results, or run `hil campaign` first"
    if out is None:
        where = str(plan.folder)
        mend = (
            "name the folder of its results with --out, run `hil campaign` first, or add --log to record the "
            "row alone"
        )
    return LogError(f"{where}: row {number} of {plan.path} is not stored there; {mend}")


def _same(a: Any, b: Any) -> bool:
    """Tell whether two cells are the same to the bit; not-a-number is itself."""
    if isinstance(a, float) and isinstance(b, float):
        return np.float64(a).tobytes() == np.float64(b).tobytes()
    return bool(a == b)


def _simulate(c: Configuration, job: Job, ended: Ended, log: Path) -> None:
    """Record the run of a row, which goes on from its end until it parks."""
    stop_tick = ended.ticks if ended.stop_tick is None else ended.stop_tick
    simulate(
        c,
        log=log,
        duration_s=stop_tick / c.loop.rate_Hz,
        faults=FaultPlan((), job.seed),
        plant_log=True,
        check_replay=False,
    )


def _from_log(c: Configuration, job: Job, again: Ran, log: Path) -> dict[str, Any]:
    """Return the outcome of a row by the ticks of its log. Raises LogError: it is shorter than the row."""
    ended = again.ended
    assert ended is not None
    measured = Measurement(travels=job.subject.rests)
    ticks = 0
    with np.errstate(all="ignore"):
        for row, length in _ticks(log):
            if ticks == ended.ticks:
                break
            measured.take(row, length)
            ticks += 1
    if ticks < ended.ticks and ended.how != "plant":
        return not_run(job, "log", f"its log has {ticks} ticks, the row {ended.ticks}")
    return outcome(job, c.loop.rate_Hz, ended, again.faults, measured)


def _ticks(log: Path) -> Iterator[tuple[Any, Array]]:
    """Yield each tick of dtype ROW, and the true lengths (6,) m of the plant's log."""
    truth = log.with_name(f"{log.stem}-plant{log.suffix}")
    rows, lengths = Log(log).rows(), Log(truth).rows("tick", "length")
    if len(rows) != len(lengths) or (rows["tick"] != lengths["tick"]).any():
        raise LogError(f"{truth}: has other ticks than {log}; remove both and repeat the row")
    yield from zip(rows, lengths["length"], strict=True)
