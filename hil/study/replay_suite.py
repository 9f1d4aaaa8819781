"""`hil replay --suite DIR`: every log of a folder replayed, each a case of its own."""

import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from rich.text import Text

from drivers.errors import HilError, LogError
from hil.app.files import printable
from hil.app.output import print_table, replay_sentence
from hil.app.replay import replay_log
from hil.record.log import Log
from hil.record.schema import IDENTITY
from hil.study.junit import Verdict
from hil.study.table import results
from hil.study.workers import Progress, perform

RUNS = ("run", "sim")
"""Kinds of logs that are replayed."""


class Case(NamedTuple):
    """What became of one log."""

    log: str
    """As found in the folder."""
    verdict: Literal["pass", "fail", "skipped"]
    text: str
    """Of one line: what the replay found, or why there was none."""
    summary: dict[str, Any]
    """As of `hil replay --json`; empty where it was not replayed."""
    wall_s: float


def logs_in(folder: Path) -> list[Path]:
    """Return the MCAP files in a folder and below it, by name. Raises LogError: no folder, or none in it."""
    if not folder.is_dir():
        raise LogError(
            f"--suite {folder}: {'is a file and no folder' if folder.exists() else 'no such folder'}"
        )
    found = sorted(
        Path(place) / name for place, _, names in os.walk(folder, onerror=_unreadable) for name in names
    )
    found = [path for path in found if path.suffix == ".mcap"]
    if not found:
        raise LogError(f"--suite {folder}: has no file *.mcap, nor has a folder in it: nothing to replay")
    return found


def _unreadable(error: OSError) -> None:
    raise LogError(f"--suite: folder {error.filename}: cannot be read: {error.strerror}")


def run_suite(paths: Sequence[Path], jobs: int | None, progress: Progress | None) -> Iterator[Case]:
    """Yield the case of each log, in the order in which they are done; jobs: processes at once."""
    yield from perform(paths, replay_case, died, jobs, progress)


def replay_case(path: Path) -> Case:
    """Replay one log; whatever is wrong with it is its own failure."""
    begun = time.perf_counter()
    try:
        found = _replayed(path)
    except (HilError, OSError) as error:
        found = Case(str(path), "fail", printable(str(error).removeprefix(f"{path}: ")), {}, 0.0)
    except Exception as error:  # noqa: BLE001 - what a damaged log makes of the code is a failure of this log
        found = Case(str(path), "fail", printable(f"{type(error).__name__}: {error}"), {}, 0.0)
    return found._replace(wall_s=time.perf_counter() - begun)


def _replayed(path: Path) -> Case:
    metadata = Log(path).metadata
    kind = metadata.get(IDENTITY, {}).get("kind")
    if kind not in RUNS:
        why = f"a log of kind {kind!r:.60}, which has no controller to replay"
        return Case(str(path), "skipped", printable(why), {}, 0.0)
    comparison, summary = replay_log(path)
    remark = f"; {summary['remark']}" if "remark" in summary else ""
    text = printable(replay_sentence(summary) + remark)
    if comparison.story is not None:
        summary["story"] = comparison.story.fields()
    return Case(str(path), "pass" if summary["agrees"] else "fail", text, summary, 0.0)


def died(path: Path) -> Case:
    """Return the case of a log whose process died."""
    return Case(str(path), "fail", "its process died", {}, 0.0)


def summary(folder: Path, cases: Sequence[Case], wall_s: float) -> dict[str, Any]:
    """Return the cases as plain values (key `success`: none failed). Raises LogError: none was replayed."""
    count = {
        verdict: sum(case.verdict == verdict for case in cases) for verdict in ("pass", "fail", "skipped")
    }
    if count["skipped"] == len(cases):
        raise LogError(
            f"--suite {folder}: has no log of `hil run` or `hil sim`, but {len(cases)} of other kinds: "
            "nothing to replay"
        )
    ordered = sorted(cases, key=lambda case: case.log)
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
        "cases": [case._asdict() for case in ordered],
        "wall_s": wall_s,
    }


def show(folder: Path, cases: Sequence[Case]) -> None:
    """Print a line for each log."""
    table = results("log", "verdict", "s", "found", left=("log", "verdict", "found"))
    styles = {"fail": "red", "skipped": "yellow"}
    for case in sorted(cases, key=lambda case: case.log):
        style = styles.get(case.verdict, "")
        verdict = "FAIL" if case.verdict == "fail" else case.verdict
        cells = (_within(folder, case), verdict, f"{case.wall_s:.1f}", case.text)
        table.add_row(*(Text(cell, style=style) for cell in cells))
    print_table(table)


def verdicts(folder: Path, cases: Sequence[Case]) -> Iterator[Verdict]:
    """Yield a case of JUnit for each log; one that was skipped passes, and says so."""
    for case in sorted(cases, key=lambda case: case.log):
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
