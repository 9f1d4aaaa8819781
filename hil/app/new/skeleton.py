"""`hil new law NAME`, `hil new protocol NAME`: writes a starting package that passes its contract tests."""

import importlib.resources
import keyword
import re
from importlib.util import find_spec
from pathlib import Path

from drivers.errors import ConfigurationError
from drivers.registry import registered
from hil.app.files import write_whole

FILES = {
    "law": {"law.py": "{name}/law.py"},
    "protocol": {"codec.py": "{name}/codec.py", "drives.py": "{name}/drives.py"},
}
"""Kind -> file of the skeleton in `configs/skeletons`, and its place in the package."""
COMMON = {"pyproject.toml": "pyproject.toml", "test.py": "tests/test_{name}.py"}
_NAMES = {"law": "soft", "protocol": "cheetah"}
"""Names of the law and the protocol in the skeletons."""
_NAME = re.compile(r"[a-z][a-z0-9_]{0,49}")


def write_skeleton(kind: str, name: str, folder: Path) -> list[Path]:
    """Write a package for a user's own law or protocol into the new folder `name`; return its files.

    Raises ConfigurationError for an invalid name or one in use, and for a folder that exists or cannot be
    written.
    """
    if _NAME.fullmatch(name) is None or keyword.iskeyword(name):
        raise ConfigurationError(f"{name!r}: allowed: a name of a-z, 0-9 and _, not a keyword of Python")
    if find_spec(name) is not None:
        raise ConfigurationError(f"{name}: there is a Python package of this name; take another name")
    taken = registered(f"hil.{kind}s").get(name)
    if taken is not None:
        raise ConfigurationError(f"{name}: there is a {kind} of this name, {taken.value}; take another name")
    root, given, title = folder / name, _NAMES[kind], name.title().replace("_", "")
    written = []
    try:
        root.mkdir()
        for file, place in (FILES[kind] | COMMON).items():
            path = root / place.format(name=name)
            path.parent.mkdir(exist_ok=True)
            text = (importlib.resources.files("configs") / "skeletons" / kind / file).read_text()
            write_whole(path, text.replace(given, name).replace(given.title(), title))
            written.append(path)
    except OSError as error:
        raise ConfigurationError(f"{error.filename or root}: {error.strerror}") from None
    return written
