"""Runs a control law in one Python file: `controller.law: ./my_law.py:MyLaw`, next to the configuration."""

import hashlib
import re
import sys
import traceback
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, TypeGuard

from pydantic import ConfigDict

from drivers.errors import ConfigurationError
from drivers.files import cache_folder, own_folder, read_regular
from drivers.registry import named
from hil.control.law import Law, LawContext, LawSettings

ATTACHMENT = "law.py"
"""Attachment of a log: source of its law."""
PATH = "law_path"
"""Key of a log's metadata: path of its law's file."""
_KNOWN = cache_folder() / "laws"
"""Digests of the laws that this user has run."""
_NAMED = re.compile(r".+\.py:[A-Za-z_]\w*")


class UnreadLaw(LawSettings):
    """Section `controller` of a log whose law is in a Python file: plain keys; the file has not been run."""

    model_config = ConfigDict(extra="allow")

    def build(self, context: LawContext) -> Law:
        """Refuse to build, since a log is untrusted input. Raises ConfigurationError."""
        del context
        raise ConfigurationError(
            f"controller.law: {self.law} is code in a file, and only `hil replay` runs the law of a log"
        )


class LawFile(NamedTuple):
    """Python file of a control law, and its source text."""

    path: Path
    source: bytes

    def described(self) -> dict[str, str]:
        """Metadata for a log: absolute path and SHA-256 of the law's file."""
        return {PATH: str(self.path.resolve()), "law_sha256": self.digest}

    @property
    def digest(self) -> str:
        """SHA-256 of the law's source, hexadecimal."""
        return hashlib.sha256(self.source).hexdigest()

    def is_known(self) -> bool:
        """True if the disk has this law file and this user has run it from a configuration before."""
        try:
            there = self.path.is_absolute() and read_regular(self.path, len(self.source)) == self.source
            return there and (own_folder(_KNOWN) / self.digest).exists()
        except OSError:
            return False


def is_file(law: object) -> TypeGuard[str]:
    """True if `controller.law` refers to a class in a Python file, `FILE.py:CLASS`."""
    return isinstance(law, str) and _NAMED.fullmatch(law) is not None


def read_law(law: str, folder: Path) -> tuple[LawFile, type[LawSettings]]:
    """Run the Python file of a law; return the file and the class of its settings.

    Raises ConfigurationError if the file cannot be read, and as `run_law`.
    """
    path = folder / law.rpartition(":")[0]
    try:
        source = read_regular(path)
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror}") from None
    file = LawFile(path, source)
    settings = run_law(law, file)
    with suppress(OSError):  # without it a replay requires --trust-code
        (own_folder(_KNOWN) / file.digest).touch()
    return file, settings


def run_law(law: str, file: LawFile) -> type[LawSettings]:
    """Run the source of a law, once per process; return the class of its settings.

    Raises ConfigurationError if the source fails, or has no subclass of LawSettings of this name.
    """
    name = law.rpartition(":")[2]
    found: Any = getattr(_module(file.source, file.path), name, None)
    if found is None:
        raise ConfigurationError(f"{file.path}: has no class {name}")
    settings: Any = named(law, found, LawSettings, "law")
    settings.__reduce__ = lambda self: (_revived, (law, file, self.model_dump()))
    return settings  # type: ignore[no-any-return]


def _revived(law: str, file: LawFile, values: dict[str, Any]) -> LawSettings:
    """Law settings unpickled from another process; the law's file is run here, too."""
    return run_law(law, file).model_validate(values)


def _module(source: bytes, path: Path) -> ModuleType:
    name = f"hil_law_{hashlib.sha256(source).hexdigest()[:16]}"
    if name not in sys.modules:
        module = sys.modules[name] = ModuleType(name)
        module.__file__ = str(path)
        try:
            exec(compile(source, str(path), "exec"), module.__dict__)  # noqa: S102 - the user's own law
        except (Exception, SystemExit) as error:
            del sys.modules[name]
            line = traceback.extract_tb(error.__traceback__)[-1].lineno
            raise ConfigurationError(f"{path}:{line}: {type(error).__name__}: {error}") from error
    return sys.modules[name]
