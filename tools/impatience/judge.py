"""What a command must not leave behind: a traceback, a process, a half file, silence."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from pathlib import Path

from drivers.errors import LogError
from hil.record.log import Log
from tools.impatience.child import Outcome

_PNG_END = b"IEND\xaeB`\x82"
_SIGNS_OF_A_DEFECT = ("Traceback", "Exception ignored", "Aborted!", "Error:", "Warning:", "core dumped")


def found_wrong(
    outcome: Outcome, folder: Path, codes: Collection[int], *, speaks: bool = True, whole: bool = True
) -> list[str]:
    """Return what is wrong with the end of a command; nothing for a good one.

    codes: those allowed; speaks: it has to say something; whole: its logs have to be closed.
    """
    wrong = []
    said = outcome.out + outcome.err
    wrong += [f"says {sign!r}" for sign in _SIGNS_OF_A_DEFECT if sign in said]
    if outcome.code not in codes:
        wrong.append(f"exit code {outcome.code}, allowed: {', '.join(map(str, sorted(codes)))}")
    if speaks and outcome.code >= 0 and not said.strip():
        wrong.append("says nothing")
    wrong += [f"left running: {words}" for words in outcome.left]
    wrong += _half_files(folder, whole=whole)
    return wrong


def _half_files(folder: Path, *, whole: bool) -> Iterator[str]:
    for path in sorted(folder.rglob("*")):
        if path.name in {".out", ".err"} or not path.is_file():
            continue
        match path.suffix:
            case ".mcap":
                try:
                    cut = Log(path).cut
                except LogError as error:
                    cut = str(error)
                if cut and whole:
                    yield f"{path.name}: {cut}"
            case ".png":
                if not path.read_bytes().endswith(_PNG_END):
                    yield f"{path.name}: half a picture"
            case ".html":
                if not path.read_text().rstrip().endswith("</html>"):
                    yield f"{path.name}: half a page"
            case ".json":
                try:
                    json.loads(path.read_text())
                except ValueError:
                    yield f"{path.name}: half a summary"
        if path.name.startswith((".", "tmp")):
            yield f"{path.name}: left behind"
