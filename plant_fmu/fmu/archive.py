"""Safe extraction of an .fmu file.

A foreign archive is untrusted until each member has been checked; no code is loaded. `zipfile` writes nothing
outside the given folder, and writes a link as a text file.
"""

import re
import zipfile
from collections.abc import Sequence
from pathlib import Path

from drivers.errors import PlantError

MAX_MEMBERS = 20_000
MAX_BYTES = 2 * 1024**3
MAX_XML_BYTES = 64 * 1024**2
"""Limit for members that are parsed: the parsed tree takes ten times the memory, even without a child
process."""
MAX_RATIO = 400
"""Largest ratio of unpacked to packed size of a member; real binaries and data stay far below."""
RATIO_FREE_BYTES = 1024**2
"""Members up to this size may have any ratio."""
PARSED = frozenset({"modelDescription.xml", "sources/buildDescription.xml"})
_HERE = re.compile(r"^(?:\./+)+(?=[^/])")


def open_archive(path: Path) -> zipfile.ZipFile:
    """Open the .fmu; a leading ``./`` of its names is dropped.

    Raises PlantError if it is missing, not a ZIP archive, or unsafe to unpack.
    """
    if not path.is_file():
        raise PlantError(f"{path}: no such file; give the path of an .fmu relative to the configuration file")
    try:
        archive = zipfile.ZipFile(path)
    except Exception as error:  # zipfile raises many types on a damaged directory
        raise PlantError(f"{path}: not an FMU (a ZIP archive with modelDescription.xml): {error}") from error
    for member in archive.infolist():
        member.filename = _HERE.sub("", member.filename)
    try:
        check_members(archive.infolist(), path)
    except PlantError:
        archive.close()
        raise
    return archive


def check_members(members: Sequence[zipfile.ZipInfo], path: Path) -> None:
    """Check number, sizes, compression ratios and names of the members, and the sizes of parsed files.

    Members whose names differ at most in case, but whose contents differ, are refused too. Raises PlantError
    with the member's name.
    """
    if len(members) > MAX_MEMBERS:
        raise PlantError(f"{path}: {len(members)} members; at most {MAX_MEMBERS} are allowed")
    seen: dict[str, tuple[int, int]] = {}
    for member in members:
        place = "/".join(part for part in member.filename.split("/") if part not in {"", ".", ".."})
        content, bad = (member.CRC, member.file_size), None
        if "\\" in member.filename:
            bad = "in a ZIP archive / separates folders, not \\; unpack the FMU and pack it again"
        elif seen.setdefault(place.casefold(), content) != content:
            bad = "its name occurs twice"
        elif member.file_size > max(RATIO_FREE_BYTES, MAX_RATIO * member.compress_size):
            bad = f"it unpacks to more than {MAX_RATIO} times its packed size"
        elif place in PARSED and member.file_size > MAX_XML_BYTES:
            bad = f"it unpacks to {member.file_size} bytes; at most {MAX_XML_BYTES} are read"
        if bad:
            raise PlantError(f"{path}: member {member.filename!r} refused: {bad}")
    total = sum(member.file_size for member in members)
    if total > MAX_BYTES:
        raise PlantError(f"{path}: unpacks to {total} bytes; at most {MAX_BYTES} are allowed")


def extract(archive: zipfile.ZipFile, path: Path, folder: Path) -> None:
    """Unpack all members into `folder`; `zipfile` reads at most the bytes that their headers state.

    Raises PlantError on a damaged member.
    """
    for member in archive.infolist():
        try:
            archive.extract(member, folder)
        except Exception as error:  # likewise on a damaged member
            raise PlantError(f"{path}: member {member.filename!r} cannot be unpacked: {error}") from error
