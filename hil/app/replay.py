"""`hil replay`: feeds a log's recorded inputs to the controller, and compares its outputs bit by bit."""

import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from drivers.arrays import Rows
from drivers.errors import HilError, LogError
from drivers.tick_columns import RECORDED
from hil.app.compose import build_cycle, databases, version_of
from hil.app.configuration.configuration import Configuration, loads
from hil.app.configuration.law_file import ATTACHMENT, PATH, LawFile, UnreadLaw
from hil.app.homing.last_pose import HOMING_JSON, recorded
from hil.app.output import fail, reason
from hil.app.readable import MOST_RATE_HZ, lacking
from hil.app.recorded_files import REFERENCE_PLAN, attached
from hil.loop.clock import collector_paused
from hil.loop.replay import Comparison, other_columns, replay
from hil.record import environment
from hil.record.figures import figures
from hil.record.log import Log
from hil.record.schema import ENVIRONMENT, SUMMARY

WHAT_IF = "what-if"
"""Kind of a log with the answers of another controller: not a run."""
_DIGITS = 19
"""Most digits of a valid count."""
MOST = {"rate_Hz": MOST_RATE_HZ, "watchdog_s": 3600.0}
"""Upper bounds of values in the metadata of a run."""
_DRAWN = "`hil plot` draws its columns"


def open_run(path: Path) -> tuple[Log, dict[str, Any], Configuration]:
    """(log, metadata, configuration) of a log of `hil run` or `hil sim`.

    Raises LogError: the file is not such a log, or has columns that this version cannot read.
    """
    log, run = _open(path)
    refuse_unread(log)
    return log, run, loads(log.configuration, f"{path}:config.yaml", files=log.attachments)


def refuse_unread(log: Log) -> None:
    """Raise LogError if a log has columns that this version cannot read."""
    there = {c.name: (c.kind, c.shape) for c in log.columns}
    other = [c.name for c in RECORDED if there.get(c.name) != (c.kind, c.shape)]
    if other:
        refusal = _other_version(log, f"its columns differ ({', '.join(other[:3])})", "read")
        raise LogError(f"{refusal}; {_DRAWN}")


def _open(path: Path) -> tuple[Log, dict[str, Any]]:
    log = Log.open(path)
    return log, run_of(log, path)


def run_of(log: Log, path: Path, needed: Iterable[str] = MOST) -> dict[str, Any]:
    """Metadata of the run in a log of `hil run` or `hil sim`.

    needed : the required keys of MOST.

    Raises LogError: another kind of log, or a required value is missing or out of range.
    """
    run: dict[str, Any] = dict(log.metadata.get("hil", {}))
    if run.get("kind") == WHAT_IF:
        raise LogError(
            f"{path}: holds a what-if on {run.get('what_if_of', 'a log')!r:.200}, not a run: its "
            "measurements did not follow its forces; allowed: the log of a run"
        )
    if run.get("kind") not in {"run", "sim"}:
        raise LogError(
            f"{path}: holds a log of kind {run.get('kind')!r}, allowed: one of `hil run` or `hil sim`; "
            f"{_DRAWN}"
        )
    for key in needed:
        try:
            run[key] = float(run[key])
            ok = 0.0 < run[key] <= MOST[key]
        except (KeyError, ValueError):
            ok = False
        if not ok:
            raise LogError(
                f"{path}: metadata record 'hil' has {key}: {run.get(key)!r:.60}, "
                f"allowed: a number > 0, at most {MOST[key]:g}"
            )
    return run


def open_replayable(path: Path, *, trust_code: bool = False) -> tuple[Log, dict[str, Any], Configuration]:
    """(log, metadata, configuration) of a log that this version can replay.

    The code of a law in a file runs only if the disk has the same file and this user has run it before, or
    with `trust_code`.

    Raises LogError: the file is not a log of `hil run` or `hil sim`, has other columns or another protocol,
    or its law is not on the disk.
    """
    log, run = _open(path)
    difference = other_columns(log.columns)
    if difference:
        raise _other_version(log, f"its columns differ ({difference})", "replay")
    configuration = loads(log.configuration, f"{path}:config.yaml", files=log.attachments)
    with attached(configuration, log.attachments) as own:
        ours = databases(own)
    changed = [(name, text) for name, text in ours if log.attachments.get(name) != text]
    if changed:
        name, text = changed[0]
        there = version_of(log.attachments.get(name, b"").decode("ascii", "replace"))
        here = version_of(text.decode())
        what = f"it was made with another {name}"
        if there != here:
            what = f"its protocol has version {there or 'unknown'}, this one {here}; {what}"
        raise _other_version(log, what, "replay")
    return log, run, law_of_log(configuration, log, run, trust_code=trust_code)


def law_of_log(c: Configuration, log: Log, run: dict[str, Any], *, trust_code: bool) -> Configuration:
    """Configuration of a log, with its law loaded where the law is in a Python file.

    Raises LogError: the disk lacks the file that the log contains, or this user has never run it from a
    configuration; `trust_code` permits both.
    """
    if not isinstance(c.controller, UnreadLaw):
        return c
    if ATTACHMENT not in log.attachments:
        raise LogError(f"{log.path}: its law is {c.controller.law}, and the log does not carry that file")
    file = LawFile(Path(run.get(PATH, "")), log.attachments[ATTACHMENT])
    if not trust_code and not file.is_known():
        raise LogError(
            f"{log.path}: its law is code, and {file.path} is not the file that the log carries "
            f"({ATTACHMENT}), or you have not run it yet. Restore it and run `hil check` with it; "
            "or read the code (`mcap get attachment`), then add --trust-code"
        )
    return c.with_law(file)


def replay_log(
    path: Path, progress: Callable[[int], None] | None = None, *, trust_code: bool = False
) -> tuple[Comparison, dict[str, Any]]:
    """Replay a log of `hil run` or `hil sim`; return the comparison and its summary.

    `progress` is called with the number of ticks done, every 1000 ticks. `trust_code`: see `open_replayable`.

    Raises LogError: the file is not such a log, or has other columns or another protocol; OSError: the files
    that it contains cannot be written to the temporary folder.
    """
    log, run, configuration = open_replayable(path, trust_code=trust_code)
    with attached(configuration, log.attachments) as configuration:
        plan = log.attachments.get(REFERENCE_PLAN)
        last_pose = recorded(path, log.attachments.get(HOMING_JSON))
        cycle = build_cycle(configuration, run["rate_Hz"], run["watchdog_s"], plan, last_pose=last_pose)
    begun = time.perf_counter()
    with collector_paused():
        comparison = replay(log, cycle, progress)
    wall = time.perf_counter() - begun
    _check_counts(log, comparison)
    result = summary(comparison, wall, comparison.ticks / run["rate_Hz"])
    there, here = log.metadata.get(ENVIRONMENT, {}).get("cpu"), environment()["cpu"]
    if there != here:
        result |= {"recorded_on": there, "replayed_on": here}
    result["agrees"] = comparison.exact or (there != here and comparison.equivalent)
    remark = lacking(log)
    if remark:
        result["remark"] = remark
    return comparison, result


def _check_counts(log: Log, comparison: Comparison) -> None:
    """Add ticks to the gaps that the log's index or end counts, but that are missing in the log.

    A truncated log has no such counts. Raises LogError: index or end count fewer ticks than the log has.
    """
    if log.cut or comparison.gaps:
        return
    index, end = log.counted(), log.metadata.get(SUMMARY, {}).get("ticks", "")
    counts = [log.summary.ticks] if index is None else [log.summary.ticks, index]
    if end:
        counts.append(int(end) if end.isdecimal() and len(end) < _DIGITS else -1)
    if max(counts) > comparison.ticks:
        comparison.gaps.append((comparison.end, max(counts) - comparison.ticks))
    elif min(counts) < comparison.ticks:
        raise LogError(
            f"{log.path}: {comparison.ticks} ticks are there"
            + (f", and its index counts {index}" if index is not None else "")
            + (f", its end {end:.20}" if end else "")
            + ": it was altered since it was written"
        )


def measured(result: dict[str, Any], path: Path, lost: str = "", *, check_replay: bool = True) -> Rows | None:
    """Add the figures of a log and its replay to the summary of the run; return the log's rows.

    lost: known reason why the log is incomplete; an unreadable log is then expected. A log that cannot be
    read or replayed makes the run a failure. The caller evaluates differences of the replay.
    """
    try:
        rows = Log.open(path).rows()
    except LogError as error:
        if not lost:
            fail(result, str(error))
        elif "recorder" in result:
            result["recorder"] += f"; {error}"
        return None
    if not len(rows):
        return rows
    result |= figures(rows)
    if check_replay:
        try:
            _, result["replay"] = replay_log(path)
        except (HilError, OSError) as error:
            fail(result, f"the log was not replayed: {reason(error)}")
    return rows


def _other_version(log: Log, difference: str, what: str) -> LogError:
    there, here = (
        f"{e.get('version', 'unknown')}" + (f" (git {e['git']})" if "git" in e else "")
        for e in (log.metadata.get(ENVIRONMENT, {}), environment())
    )
    other = f"version {there}, which made it; this is {here}"
    if there == here:
        other = f"the build of version {there} that made it; this is another one, or the log was altered"
    return LogError(f"{log.path}: {difference}: {what} it with {other}")


def summary(comparison: Comparison, wall_s: float, logged_s: float) -> dict[str, Any]:
    """Comparison of a replay with its log, as plain values; wall_s, logged_s: durations, s."""
    return {
        "exact": comparison.exact,
        "equivalent": comparison.equivalent,
        "ticks": comparison.ticks,
        "frames": comparison.frames,
        "different_ticks": comparison.different_ticks,
        "wire_different_ticks": comparison.wire_different_ticks,
        "largest_relative_difference": comparison.largest,
        "first": [str(d) for d in comparison.first],
        "gaps": [f"{count} ticks missing from tick {tick}" for tick, count in comparison.gaps],
        "wall_s": wall_s,
        "times_real_time": logged_s / wall_s if wall_s > 0 else 0.0,
    }
