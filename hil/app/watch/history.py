"""Earlier runs for the live page: the logs of a folder, and reports about one or two of them."""

import tempfile
import threading
import time
from collections.abc import Iterator
from http import HTTPStatus
from math import isfinite
from pathlib import Path
from subprocess import DEVNULL, PIPE
from typing import Any

from drivers.child_process import start
from drivers.errors import LogError
from drivers.signals import Fault
from hil.app.configuration.yaml_positions import parse
from hil.app.readable import lacking
from hil.app.terminal import one_line
from hil.app.watch.access import Refused
from hil.record.log import PLANT_TOPIC, Log
from hil.record.schema import PEAK_ERROR, SPAN, SUMMARY

MOST = 200
"""Most logs listed, the newest first."""


class History:
    """Logs of a folder. State: rows of known logs by name, time and size; the lock of the only report."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.absolute()
        self._rows: dict[tuple[str, int, int], dict[str, Any] | None] = {}
        self._lock, self._reporting = threading.Lock(), threading.Lock()

    def runs(self) -> dict[str, Any]:
        """Name of the folder, number of its logs, and a row of figures for each of the newest ones."""
        files = sorted(self._files(), key=lambda each: -each[1])
        with self._lock:
            known = self._rows
            self._rows = {
                each: known[each] if each in known else _row(self._folder / each[0]) for each in files[:MOST]
            }
            rows = [row for row in self._rows.values() if row is not None]
        return {"folder": self._folder.name, "more": len(files) if len(files) > MOST else 0, "runs": rows}

    def page(self, names: list[str]) -> bytes:
        """Report about one log, or about two side by side, made in a process of its own. Raises Refused."""
        if not 1 <= len(names) <= 2 or not {name for name, *_ in self._files()}.issuperset(names):
            raise Refused(HTTPStatus.NOT_FOUND, "no such log in the folder")
        if not self._reporting.acquire(blocking=False):
            raise Refused(HTTPStatus.SERVICE_UNAVAILABLE, "another report is being made: try again later")
        try:
            with tempfile.TemporaryDirectory(prefix="hil-report-") as folder:
                out, logs = Path(folder) / "report.html", [str(self._folder / name) for name in names]
                words = "report", *logs, "--out", str(out)
                _, trouble = start("hil.cli", *words, stderr=PIPE, stdout=DEVNULL).communicate()
                if not out.exists():
                    raise Refused(HTTPStatus.INTERNAL_SERVER_ERROR, trouble.decode(errors="replace").strip())
                return out.read_bytes()
        finally:
            self._reporting.release()

    def _files(self) -> Iterator[tuple[str, int, int]]:
        """Logs of the folder: name, time of the last change, ns, and size, bytes; none without the folder."""
        for path in self._folder.glob("*.mcap"):
            try:
                found = path.stat()
            except OSError:  # removed since
                continue
            yield path.name, found.st_mtime_ns, found.st_size


def _row(path: Path) -> dict[str, Any] | None:
    """Figures of a log from the metadata at its ends, without its ticks; None for the log of a plant."""
    try:
        log = Log(path)
        document = parse(log.configuration).value
    except LogError as error:
        return {"file": path.name, "trouble": one_line(str(error).removeprefix(f"{path}: "))}
    if log.topic == PLANT_TOPIC:
        return None
    end, settings = log.metadata.get(SUMMARY, {}), document or {}
    controller = settings.get("controller")
    bits = int(_number(end.get("faults")) or 0)
    names = ", ".join(str(fault.name) for fault in Fault if fault & bits)
    trouble = lacking(log) or (f"fault {names}" if names else end.get("reason", ""))
    return {
        "file": path.name,
        "good": not trouble,
        "verdict": one_line(trouble) or end.get("ending", "").lower(),
        "configuration": str(settings.get("name", "")),
        "law": str(controller.get("law", "")) if isinstance(controller, dict) else "",
        "duration_s": _number(end.get(SPAN)),
        "peak_error_mm": _number(end.get(PEAK_ERROR)),
        "written": time.strftime("%Y-%m-%d %H:%M", time.localtime(path.stat().st_mtime)),
    }


def _number(text: str | None) -> float | None:
    """A finite number of the metadata; None for any other text."""
    try:
        number = float(text or "")
    except ValueError:
        return None
    return number if isfinite(number) else None
