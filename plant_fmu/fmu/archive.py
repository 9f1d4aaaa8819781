"""Guarded extraction of an .fmu file.

A foreign archive is hostile until each member has been looked at; nothing is loaded. `zipfile` writes nothing
outside the given folder, and a link as a file of text.
"""

import lzma
import zipfile
import zlib
from pathlib import Path

from drivers.errors import PlantError

MAX_MEMBERS = 20_000
MAX_BYTES = 2 * 1024**3
MAX_XML_BYTES = 64 * 1024**2
"""Of a member that is parsed: its tree takes some ten times that, also where no child process bounds it."""
MAX_RATIO = 400
"""Largest size of a member over its packed size; real binaries and data stay far below."""
RATIO_FREE_BYTES = 1024**2
"""Members up to this size may have any ratio."""
_PARSED = frozenset({"modelDescription.xml", "sources/buildDescription.xml"})
_DAMAGED = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, OSError, EOFError, ValueError, RuntimeError)
"""What zipfile raises on a directory or a member that is damaged or cannot be read."""


def open_archive(path: Path) -> zipfile.ZipFile:
    """Open the .fmu. Raises PlantError if it is missing or no ZIP archive."""
    if path.exists() and not path.is_file():
        raise PlantError(f"{path}: no FMU: a folder, pipe, socket or device; give the path of an .fmu")
    if not path.is_file():
        raise PlantError(
            f"{path}: no such FMU file; give the path of an .fmu relative to the configuration file"
        )
    try:
        return zipfile.ZipFile(path)
    except _DAMAGED as error:
        raise PlantError(f"{path}: not an FMU (a ZIP archive with modelDescription.xml): {error}") from error


def checked_members(archive: zipfile.ZipFile, path: Path) -> list[zipfile.ZipInfo]:
    """Return all members if every one of them may be extracted, a doubled one once.

    Refused: two different ones with one name (also one name on a file system that ignores case), too many,
    too large or too strongly packed ones, descriptions that are too large to be parsed. Raises PlantError
    naming the member.
    """
    members = archive.infolist()
    if len(members) > MAX_MEMBERS:
        raise PlantError(f"{path}: {len(members)} members; at most {MAX_MEMBERS} are allowed")
    seen: dict[str, zipfile.ZipInfo] = {}  # by the place to which it is extracted, without case
    total = 0
    for member in members:
        name, bad = member.filename, None
        place = "/".join(part for part in name.split("/") if part not in {"", ".", ".."})
        key = place.casefold()
        if not _same(member, seen.get(key, member)):
            bad = "its name occurs twice"
        elif member.file_size > max(RATIO_FREE_BYTES, MAX_RATIO * member.compress_size):
            bad = f"it unpacks to more than {MAX_RATIO} times its packed size"
        elif place in _PARSED and member.file_size > MAX_XML_BYTES:
            bad = f"it unpacks to {member.file_size} bytes; at most {MAX_XML_BYTES} are read"
        if bad:
            raise PlantError(f"{path}: member {name!r} refused: {bad}")
        if seen.setdefault(key, member) is member:
            total += member.file_size
    if total > MAX_BYTES:
        raise PlantError(f"{path}: unpacks to {total} bytes; at most {MAX_BYTES} are allowed")
    return list(seen.values())


def _same(member: zipfile.ZipInfo, other: zipfile.ZipInfo) -> bool:
    """Tell whether two entries of a directory are the same file or folder."""
    names = member.filename == other.filename or (member.is_dir() and other.is_dir())
    return names and (member.CRC, member.file_size) == (other.CRC, other.file_size)


def read_member(archive: zipfile.ZipFile, name: str, path: Path) -> bytes:
    """Return the content of one member. Raises PlantError if it is missing or damaged."""
    try:
        return archive.read(name)
    except KeyError:
        raise PlantError(f"{path}: not an FMU: {name} is missing") from None
    except _DAMAGED as error:
        raise PlantError(f"{path}: {name} is damaged: {error}") from error


def extract(archive: zipfile.ZipFile, path: Path, folder: Path) -> None:
    """Unpack all checked members into `folder`; `zipfile` reads no more bytes than their headers announce.

    Raises PlantError on a member that is refused or damaged.
    """
    for member in checked_members(archive, path):
        try:
            archive.extract(member, folder)
        except _DAMAGED as error:
            raise PlantError(f"{path}: member {member.filename!r} cannot be unpacked: {error}") from error
