"""Output of commands: log names, the summary on the terminal, its JSON file, the picture."""

from __future__ import annotations

import json
import math
import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from drivers.errors import HilError, LogError
from drivers.files import made_folder
from hil.app.files import PICTURE, Kind, new_file, printable, write_whole
from hil.app.terminal import visible

if TYPE_CHECKING:
    from hil.loop.run_end import Ending  # its kernels are imported only by commands that run


def log_path(folder: str, name: str, given: Path | None, suffix: str = "") -> Path:
    """Path of the log to write: the given path, or a new dated name in the recordings folder.

    Raises LogError: the file exists (a log is never overwritten), or its folder cannot be made or written.
    """
    path = _dated(Path(folder), name, f"{suffix}.mcap") if given is None else given
    _make_folder(path, "--log" + " or recording.folder" * (given is None))
    return new_file(path, option="--log" if given else "recording.folder:")


def _dated(folder: Path, name: str, end: str) -> Path:
    stem = f"{name}-{time.strftime('%Y%m%dT%H%M%S', time.gmtime())}"
    numbered = (f"{stem}{end}" if n == 1 else f"{stem}-{n}{end}" for n in count(1))
    return next(folder / each for each in numbered if not os.path.lexists(folder / each))


def _make_folder(file: Path, option: str) -> None:
    try:
        made_folder(file.parent)
    except OSError as error:
        raise LogError(
            f"{file}: folder {file.parent} cannot be made: {error.strerror}; name another file with {option}"
        ) from None


def picture_path(folder: str, stem: str, given: Path | None, option: str = "--picture") -> Path:
    """Path of the PNG file to write: the given path, or a new dated name in its or the recordings folder.

    option: the option that sets the path. Raises LogError: the file exists and is not a PNG picture, or its
    folder cannot be made or written.
    """
    path = Path(folder) if given is None else given
    if given is None or given.is_dir():
        path = _dated(path, stem, ".png")
    if path.suffix.lower() != ".png":
        raise LogError(f"{option} {path}: the picture is a PNG file; let its name end in .png")
    _make_folder(path, option)
    return new_file(path, option=option, own=PICTURE)


def picture_beside(file: Path, option: str) -> Path:
    """Path of the PNG file next to another output, set by `option`. Raises LogError as `picture_path`."""
    if file.suffix.lower() == ".png":
        raise LogError(f"{option} {file}: its picture takes a name in .png; let this one end otherwise")
    return picture_path("", "", file.with_suffix(".png"), f"{option} {file}: the picture")


def check_json_path(path: Path) -> None:
    """Refuse a summary file (--json) that cannot be written, before anything starts.

    A pipe or a device is allowed. Raises LogError, as `new_file`.
    """
    if path.is_file() or path.is_dir() or not path.exists():
        new_file(path, option="--json", own=Kind("a summary of hil", _is_summary))


def _is_summary(path: Path) -> bool:
    try:
        found = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        return False
    return isinstance(found, dict) and "success" in found


def write_json(path: Path, summary: dict[str, Any]) -> None:
    """Write a summary as JSON, atomically; numbers that are not finite become null.

    Raises LogError: the folder cannot be written.
    """
    text = json.dumps(_plain(summary), indent=2, allow_nan=False) + "\n"
    try:
        write_whole(path, text)
    except OSError as error:
        raise LogError(f"--json {path}: cannot be written: {error.strerror}") from None


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def fail(summary: dict[str, Any], why: str) -> None:
    """Mark the summary of a run as failed, and append `why` to its `trouble`; no change if `why` is empty.

    The summary is still written: the platform moved, and the summary is the record of it.
    """
    if why:
        trouble = "; ".join(filter(None, (summary.get("trouble"), why)))
        summary |= {"success": False, "trouble": trouble}


@contextmanager
def further(summary: dict[str, Any]) -> Iterator[None]:
    """Context in which a command writes one more output after its main work.

    An error is added to `unwritten` of the summary, which is marked as failed; the work is not lost.
    """
    try:
        yield
    except (HilError, OSError) as error:
        summary["success"] = False
        summary["unwritten"] = [*summary.get("unwritten", ()), reason(error)]


def reason(error: HilError | OSError) -> str:
    """Text of an error, with the file that it is about."""
    if isinstance(error, OSError):
        return ": ".join(str(part) for part in (error.filename, error.strerror or error) if part)
    return str(error)


def fault_story(ending: Ending) -> dict[str, Any] | None:
    """Explanation of a run's faults for its summary, as plain values; None without a fault."""
    return None if ending.story is None else ending.story.fields()


def end_record(ending: Ending, trouble: str) -> dict[str, Any]:
    """Fields about the end of a run that its log stores."""
    end: dict[str, Any] = {"ending": ending.mode.name, "reason": trouble, "faults": int(ending.faults)}
    return end if ending.story is None else end | {"story": fault_story(ending)}


def after_run(ending: Ending) -> str:
    """How a run ended, as the beginning of a message about an error after the run."""
    return f"after the run, which ended in {ending.mode.name}" + f": {ending.trouble}" * bool(ending.trouble)


@contextmanager
def leaving(there: Callable[[], str]) -> Iterator[None]:
    """Context that adds the text of `there()`, the outputs so far, to a KeyboardInterrupt without a text."""
    try:
        yield
    except KeyboardInterrupt as interrupt:
        raise KeyboardInterrupt(str(interrupt) or there()) from None


def warn(text: str) -> None:
    """Print a warning to standard error."""
    click.secho(visible(text), fg="yellow", bold=True, err=True)


UNITS = {
    "_m2_s4": "(m/s^2)^2",
    "_m_s": "m/s",
    "_us": "us",
    "_ms": "ms",
    "_s": "s",
    "_mm": "mm",
    "_deg": "deg",
    "_N": "N",
    "_Hz": "Hz",
    "_MB": "MB",
    "_percent": "%",
}
"""Unit by the suffix of a key; the longest suffix first."""
_SILENT = frozenset({"success", "kind", "story", "unwritten"})
"""Keys that the headline shows, or that are for the JSON file only."""


_DETAILS = (
    "ending ticks final_mode first_motion_s wall_s real_time_factor recorder_cpu_s resident_MB compute_us "
    "peak_V_m2_s4 bound_at_peak_m2_s4 largest_share_percent watched_ticks syncs commands final_states "
    "peak_final_rate_m_s"
)
"""Figures of a run that only -v prints."""
_COUNTERS = (
    "faults limited_ticks stale_ticks skipped_ticks rejected_frames dropped_ticks alarms stretches missing "
    "stood_still_ms longest_ms"
)
"""Figures of a run that are printed, without -v, only if they are not 0 or empty."""


def brief(summary: dict[str, Any]) -> dict[str, Any]:
    """Figures of a summary that a command prints without -v."""
    kept: dict[str, Any] = {}
    details, counters = _DETAILS.split(), _COUNTERS.split()
    for key, value in summary.items():
        group = value if isinstance(value, dict) else {}
        idle = not (any(group.values()) or (value and not group))
        good = (key == "plant" and group.get("success")) or (key == "real_time" and not group["missing"])
        if key in details or good or (key in counters and idle):
            continue
        kept[key] = brief(value) if group and key not in {"replay", "pushes"} else value
    return kept


def headline(title: str, summary: dict[str, Any]) -> str:
    """First line of a summary; for a run that tracked a reference a sentence with its quality."""
    if not summary["success"]:
        return f"{title}: failed"
    tracking = summary.get("tracking")
    if not (tracking and tracking["ticks"]):
        return f"{title}: success"
    limited = sum(summary["limited_ticks"].values())
    late, lost = summary["stale_ticks"], summary["dropped_ticks"]
    parts = (
        f"tracked {tracking['ticks'] / summary['rate_Hz']:.3g} s",
        f"peak leg error {number(tracking['peak_leg_error_mm'])} mm",
        f"force limited in {limited} ticks" if limited else "no force limited",
        f"late feedback in {late} ticks" if late else "",
        f"{lost} ticks not recorded" if lost else "",
        "replay exact" if summary.get("replay", {}).get("different_ticks") == 0 else "",
    )
    return f"Good: {', '.join(filter(None, parts))}"


def show(title: str, summary: dict[str, Any], *, whole: bool = True) -> None:
    """Print a summary: a headline, and one aligned line for each figure with its unit.

    whole: False leaves out the details of a run, see `brief`.
    """
    line = headline(title, summary)
    for part in fold(line, _width()):
        click.secho(part, fg="green" if summary["success"] else "red", bold=True)
    rows = figure_rows(summary if whole else brief(summary))
    column = max((len(label) for label, _ in rows), default=0) + 2
    for label, value in rows:
        first, *rest = fold(value, _width() - column)
        for start, part in ((label, first), *(("", each) for each in rest)):
            click.echo(printable(f"{start:<{column}}{part}".rstrip()))


def show_lines(lines: Iterable[str]) -> None:
    """Print lines folded to the width of the terminal, each at its own indentation."""
    for line in map(visible, lines):
        text = line.lstrip()
        indent = len(line) - len(text)
        for n, part in enumerate(fold(text, _width() - indent - 4)):
            click.echo(" " * (indent + 4 * (n > 0)) + part)


def _width() -> int:
    return shutil.get_terminal_size().columns


def fold(text: str, width: int) -> list[str]:
    """Break a text into lines of `width` characters, after a phrase if possible; a path stays whole."""
    lines, width = [], max(width, 20)
    while len(text) > width:
        phrase = max(text.rfind(end, 0, width) + 1 for end in ("; ", ", ", ": ", " ("))
        word = text.rfind(" ", 0, width + 1)
        cut = phrase if 2 * phrase > width else word if word > 0 else text.find(" ")
        if cut < 0:
            break
        lines.append(text[:cut].rstrip())
        text = text[cut:].lstrip()
    return [*lines, text]


def figure_rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Figures of a summary as (name, value with unit) for a table."""
    return list(_rows(summary, ""))


def _rows(values: dict[str, Any], indent: str) -> Iterator[tuple[str, str]]:
    for key, value in values.items():
        if key in _SILENT or value is None:
            continue
        if isinstance(value, dict) and not any(value.values()) and "max" in value:
            continue  # simulated time: no wake-ups and no computing time
        name, unit = _name_and_unit(key)
        label = indent + name
        if key == "replay":
            yield label, replay_sentence(value)
        elif not isinstance(value, dict):
            yield label, _text(value, unit)
        elif key == "pushes":
            yield label, f"{value['count']} on legs at rest, by {value['largest_N']:.3g} N at most"
        elif set(value) == {"p50", "p99", "max"}:
            yield label, ", ".join(f"{k} {number(v)}" for k, v in value.items()) + f" {unit}"
        elif key == "limited_ticks":
            acted = [f"{_name_and_unit(k)[0].lower()} {n}" for k, n in value.items() if n]
            yield label, ", ".join(acted) or "none"
        elif value:
            yield label, "" if value.get("success", True) else "failed"
            yield from _rows(value, indent + "  ")


def replay_sentence(summary: dict[str, Any]) -> str:
    """Result of a replay in one sentence; summary: of `hil.app.replay.summary`."""
    ticks, different = summary["ticks"], summary["different_ticks"]
    if not ticks:
        return "0 ticks: nothing to compare"
    sentence = f"{ticks} ticks, {different} difference{'s' * (different != 1)}"
    if different:
        place = summary["first"][0].partition(": recorded ")[0]
        sentence += f" ({summary['wire_different_ticks']} in sent frames), the first in {place}"
    return "; ".join((sentence, *summary["gaps"]))


_NAMES = {
    "peak_V": "largest V (energy of the tracking error)",
    "bound_at_peak": "largest V allowed at that time",
    "largest_share": "error, largest share of its certified limit",
    "watched_ticks": "ticks compared with the limit",
    "syncs": "SYNCs, polls or remote frames received",
}
"""Figures whose keys need other words."""


def _name_and_unit(key: str) -> tuple[str, str]:
    for end, unit in UNITS.items():
        if key.endswith(end):
            name = key.removesuffix(end)
            return _NAMES.get(name, name.replace("_", " ")), unit
    return _NAMES.get(key, key.replace("_", " ")), ""


def _text(value: Any, unit: str) -> str:
    if isinstance(value, list):
        same = len(value) > 1 and all(v == value[0] for v in value)
        return f"all {value[0]}" if same else "; ".join(map(str, value)) or "none"
    return f"{number(value)} {unit}".rstrip()


def number(value: Any) -> str:
    """Number as text: three digits below 100, larger numbers in full."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"
    return str(value)
