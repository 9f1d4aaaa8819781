"""`hil replay --suite DIR`: replays every log of a folder; each log is one test case."""

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from drivers.errors import HilError, LogError
from hil.app.files import printable
from hil.app.output import replay_sentence
from hil.app.replay import replay_log
from hil.record.log import Log
from hil.record.schema import IDENTITY
from hil.study.junit import Verdict
from hil.study.table import Column, print_rows
from hil.study.workers import Progress, perform

RUNS = ("run", "sim")
"""Kinds of logs that can be replayed."""
Outcome = Literal["pass", "fail", "skipped"]


class Case(NamedTuple):
    """Result of replaying one log of a suite."""

    log: str
    """Path as found in the folder."""
    verdict: Outcome
    text: str
    """Result of the replay, or the reason for no replay; one line."""
    summary: dict[str, Any] = {}
    """Summary as of `hil replay --json`; empty if not replayed."""
    wall_s: float = 0.0


def logs_in(folder: Path) -> list[Path]:
    """MCAP files in a folder and its subfolders, sorted. Raises LogError if folder or files are missing."""
    if not folder.is_dir():
        raise LogError(f"--suite {folder}: no such folder")
    found = sorted(path for path in folder.rglob("*.mcap") if path.is_file())
    if not found:
        raise LogError(f"--suite {folder}: has no file *.mcap, not even in its subfolders")
    return found


def run_suite(paths: Sequence[Path], jobs: int | None, progress: Progress | None) -> Iterator[Case]:
    """Replay logs in `jobs` processes; yield one result per log, in the order of completion."""
    return perform(paths, replay_case, died, jobs, progress)


def replay_case(path: Path) -> Case:
    """Replay one log; any error becomes a failed case."""
    begun = time.perf_counter()
    try:
        case = _replayed(path)
    except (HilError, OSError) as error:
        case = Case(str(path), "fail", str(error).removeprefix(f"{path}: "))
    except Exception as error:  # noqa: BLE001 - what a damaged log makes of the code is a failure of this log
        case = Case(str(path), "fail", f"{type(error).__name__}: {error}")
    return case._replace(text=printable(case.text), wall_s=time.perf_counter() - begun)


def _replayed(path: Path) -> Case:
    kind = Log(path).metadata.get(IDENTITY, {}).get("kind")
    if kind not in RUNS:
        return Case(str(path), "skipped", f"a log of kind {kind!r:.60}, which contains no controller")
    comparison, summary = replay_log(path)
    remark = f"; {summary['remark']}" if "remark" in summary else ""
    if comparison.story is not None:
        summary["story"] = comparison.story.fields()
    verdict: Outcome = "pass" if summary["agrees"] else "fail"
    return Case(str(path), verdict, replay_sentence(summary) + remark, summary)


def died(path: Path) -> Case:
    """Result for a log whose replaying process died."""
    return Case(str(path), "fail", "its process died")


def summary(folder: Path, cases: Sequence[Case], wall_s: float) -> dict[str, Any]:
    """Summary of a suite of replayed logs (`success`: none failed). Raises LogError: none was replayed."""
    count = Counter(case.verdict for case in cases)
    if count["skipped"] == len(cases):
        raise LogError(
            f"--suite {folder}: has no log of `hil run` or `hil sim`, only {len(cases)} of other kinds"
        )
    ticks = sum(case.summary.get("ticks", 0) for case in cases)
    return {
        "success": not count["fail"],
        "kind": "replay_suite",
        "folder": str(folder),
        "logs": len(cases),
        "passed": count["pass"],
        "failed": count["fail"],
        "skipped": count["skipped"],
        "ticks": ticks,
        "ticks_per_second": ticks / wall_s if wall_s > 0 else 0.0,
        "cases": [case._asdict() for case in sorted(cases)],
        "wall_s": wall_s,
    }


def show(folder: Path, cases: Sequence[Case]) -> None:
    """Print a table with one line per log of the suite."""
    columns = (
        Column("log", lambda case: _within(folder, case), left=True),
        Column("verdict", lambda case: "FAIL" if case.verdict == "fail" else case.verdict, left=True),
        Column("s", lambda case: f"{case.wall_s:.1f}"),
        Column("found", lambda case: case.text, left=True),
    )
    styles = {"fail": "red", "skipped": "yellow"}
    print_rows(columns, sorted(cases), lambda case: styles.get(case.verdict, ""))


def verdicts(folder: Path, cases: Sequence[Case]) -> Iterator[Verdict]:
    """Yield one JUnit test case per log; a skipped log passes, with the reason as its output."""
    for case in sorted(cases):
        place = Path(_within(folder, case))
        yield Verdict(
            group=str(place.parent),
            name=place.name,
            failure=case.text if case.verdict == "fail" else None,
            detail="\n".join(case.summary.get("first", ())),
            output=f"skipped: {case.text}" if case.verdict == "skipped" else case.text,
            wall_s=case.wall_s,
        )


def _within(folder: Path, case: Case) -> str:
    return printable(Path(case.log).relative_to(folder))
