"""`hil view`: the file that a viewer needs, written beside the log, and the viewer started on it."""

import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from drivers.errors import LogError
from hil.app.files import made_whole, new_file
from hil.record.log import Log
from hil.study.view import foxglove, plotjuggler
from hil.study.view.recording import write_rrd


class Viewer(NamedTuple):
    """One viewer."""

    suffix: str
    """Of the file, after the name of the log."""
    write: Callable[[Log, Path], object]
    """Writes the file."""
    start: Callable[[Path, Path], Sequence[str] | None]
    """Log and file -> command; None where the program is not installed."""
    by_hand: str
    """What to do where it is not started; `{log}` and `{file}` are filled in."""


def _rerun(log: Path, file: Path) -> Sequence[str] | None:
    del log
    # by itself it listens on all addresses
    command = [sys.executable, "-m", "rerun", "--bind", "127.0.0.1", str(file)]
    return command if find_spec("rerun") else None


def _foxglove(log: Path, file: Path) -> Sequence[str] | None:
    del file
    program = next(filter(None, map(shutil.which, ("lichtblick", "foxglove-studio"))), None)
    return [program, str(log)] if program else None


def _plotjuggler(log: Path, file: Path) -> Sequence[str] | None:
    del log
    program = shutil.which("plotjuggler")
    return [program, "-n", "-l", str(file)] if program else None


VIEWERS = {
    "rerun": Viewer(
        ".rrd", lambda log, path: write_rrd(log, path, ()), _rerun, "rerun --bind 127.0.0.1 {file}"
    ),
    "foxglove": Viewer(
        "-foxglove.json",
        lambda log, path: path.write_text(foxglove.layout(log.columns, log.topic), "utf-8"),
        _foxglove,
        "open {log} in Foxglove or Lichtblick and import the layout {file}",
    ),
    "plotjuggler": Viewer(
        "-plotjuggler.xml",
        lambda log, path: path.write_text(plotjuggler.layout(log.columns, log.topic, log=log.path), "utf-8"),
        _plotjuggler,
        "plotjuggler -n -l {file}",
    ),
}
"""Name -> viewer."""


def view(
    path: Path, name: str, *, out: Path | None = None, force: bool = False, start: bool = True
) -> dict[str, Any]:
    """Write what the viewer `name` needs, start it and wait until it is closed; return the summary.

    The file goes to `out`, which is not overwritten without `force`; else beside the log, in the place of an
    earlier one. A viewer that is not installed is no error: the summary says what to do by hand.

    Raises LogError: no log, the file exists or cannot be written, the extra is missing.
    """
    viewer = VIEWERS[name]
    log = Log(path)
    file = new_file(out or path.with_name(path.stem + viewer.suffix), force=force or out is None)
    with made_whole(file, overwrite=True) as temporary:
        viewer.write(log, temporary)
    result: dict[str, Any] = {
        "success": not log.cut,
        "kind": "view",
        "trouble": f"{path}: {log.cut}; what is there is shown" if log.cut else None,
        "log": str(path),
        "viewer": name,
        "written": str(file),
    }
    command = viewer.start(path, file) if start else None
    result["next"] = viewer.by_hand.format(log=path, file=file)
    if command is not None:
        try:
            code = subprocess.run(command, check=False).returncode
        except OSError as error:
            raise LogError(f"{command[0]}: does not start: {error.strerror}; {result['next']}") from error
        if code:
            result |= {
                "success": False,
                "trouble": f"{name} ended with exit code {code}: see what it said above",
            }
    return result
