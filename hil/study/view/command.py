"""`hil view`: writes a viewer's file next to the log, and starts the viewer."""

import importlib.resources
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

from drivers.errors import LogError
from drivers.files import real_path
from hil.app.files import made_whole, new_file
from hil.record.log import Log
from hil.study.view.recording import write_rrd

OPENED = """<root>
 <previouslyLoaded_Datafiles>
  <fileInfo filename={} prefix="">
   <plugin ID="DataLoad MCAP">
    <parameters use_timestamp="0" use_mcap_log_time="1" clamp_large_arrays="0" max_array_size="500" selected_topics={}/>
   </plugin>
  </fileInfo>
 </previouslyLoaded_Datafiles>
"""  # noqa: E501
"""Part of a PlotJuggler 3.16 layout that opens a log without a dialogue about topics."""


def _layout(name: str, log: Log) -> str:
    """Shipped viewer layout, for the topic of a log; plots of missing columns stay empty."""
    text = (importlib.resources.files("configs") / "viewers" / name).read_text("utf-8")
    return text.replace("/tick", log.topic)


def _opening(log: Log) -> str:
    opened = OPENED.format(quoteattr(str(real_path(log.path))), quoteattr(log.topic))
    return _layout("plotjuggler.xml", log).replace("<root>\n", opened)


class Viewer(NamedTuple):
    """A log viewer: the file that it reads, how to write that file, and how to start the viewer."""

    suffix: str
    """Suffix of the file, after the name of the log."""
    write: Callable[[Log, Path], object]
    """Writes the file."""
    programs: Sequence[str]
    """Candidates; the first installed one is started."""
    words: Sequence[str]
    """Arguments of the program; `{log}` and `{file}` are filled in, also in `by_hand`."""
    by_hand: str
    """Instruction for a viewer that is not started."""


VIEWERS = {
    "rerun": Viewer(
        ".rrd",
        lambda log, path: write_rrd(log, path, ()),
        (sys.executable,),
        ("-m", "rerun", "--bind", "127.0.0.1", "{file}"),  # by default it listens on all addresses
        "rerun --bind 127.0.0.1 {file}",
    ),
    "foxglove": Viewer(
        "-foxglove.json",
        lambda log, path: path.write_text(_layout("foxglove.json", log), "utf-8"),
        ("lichtblick", "foxglove-studio"),
        ("{log}",),
        "open {log} in Foxglove or Lichtblick and import the layout {file}",
    ),
    "plotjuggler": Viewer(
        "-plotjuggler.xml",
        lambda log, path: path.write_text(_opening(log), "utf-8"),
        ("plotjuggler",),
        ("-n", "-l", "{file}"),
        "plotjuggler -n -l {file}",
    ),
}
"""Name -> viewer."""


def view(
    path: Path, name: str, *, out: Path | None = None, force: bool = False, start: bool = True
) -> dict[str, Any]:
    """Write the file of viewer `name`, start the viewer and wait until it is closed; return the summary.

    The file goes to `out`, which is overwritten only with `force`; by default next to the log, in place of an
    earlier one. A viewer that is not installed is no error: the summary has an instruction for it.

    Raises LogError: not a log, the file exists or cannot be written, or the extra is missing.
    """
    viewer = VIEWERS[name]
    log = Log(path)
    file = new_file(out or path.with_name(path.stem + viewer.suffix), force=force or out is None)
    with made_whole(file, overwrite=True) as temporary:
        viewer.write(log, temporary)
    result: dict[str, Any] = {
        "success": not log.cut,
        "kind": "view",
        "trouble": f"{path}: {log.cut}; shown up to there" if log.cut else None,
        "log": str(path),
        "viewer": name,
        "written": str(file),
        "next": viewer.by_hand.format(log=path, file=file),
    }
    program = next(filter(None, map(shutil.which, viewer.programs)), None) if start else None
    if program is not None:
        words = [word.format(log=path, file=file) for word in viewer.words]
        try:
            code = subprocess.run([program, *words], check=False).returncode
        except OSError as error:
            raise LogError(f"{program}: does not start: {error.strerror}; {result['next']}") from error
        if code:
            trouble = f"{name} ended with exit code {code}: see its messages above"
            result |= {"success": False, "trouble": trouble}
    return result
