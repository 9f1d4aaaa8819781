"""Where Matplotlib keeps its list of fonts."""

import os
from pathlib import Path

from drivers.cache_folder import CACHE_FOLDER
from drivers.files import made_folder

_NAME = "MPLCONFIGDIR"


def choose_picture_folder() -> None:
    """Name a folder in our cache to Matplotlib where it could not write its own, of which it would complain.

    A folder that the user has named stays. Raises OSError.
    """
    home = os.path.expanduser("~")  # noqa: PTH111 - Path.home raises where there is none
    own = (("XDG_CONFIG_HOME", ".config"), ("XDG_CACHE_HOME", ".cache"))
    folders = [Path(os.environ.get(name) or Path(home, default), "matplotlib") for name, default in own]
    if not os.environ.get(_NAME) and not all(map(_writable, folders)):
        os.environ[_NAME] = str(made_folder(CACHE_FOLDER / "matplotlib"))


def _writable(path: Path) -> bool:
    """Tell whether a folder can be written, or made."""
    while not os.path.lexists(path) and path != path.parent:
        if not os.access(path.parent, os.X_OK) and os.path.lexists(path.parent):
            return False
        path = path.parent
    return os.access(path, os.W_OK | os.X_OK)
