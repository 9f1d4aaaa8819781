"""The files that a log carries, in the place of those that its configuration names."""

import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from drivers.errors import LogError
from hil.app.compose import NAMED_FILES
from hil.app.configuration.configuration import Configuration


@contextmanager
def attached(configuration: Configuration, files: Mapping[str, bytes]) -> Iterator[Configuration]:
    """Yield what `with_attachments` returns; nothing is written where the configuration names no file.

    Raises LogError, as that does; OSError where the disk of temporary files takes none.
    """
    if not any(isinstance(getattr(configuration, section), kind) for _, section, _, kind, _ in NAMED_FILES):
        yield configuration
        return
    with tempfile.TemporaryDirectory(prefix="hil-log-files-") as folder:
        yield with_attachments(configuration, files, Path(folder))


def with_attachments(configuration: Configuration, files: Mapping[str, bytes], folder: Path) -> Configuration:
    """Return the configuration with the files of a log in the place of those that it names.

    They are written to `folder`, with the controller that comes with the product never in their place: what
    replay reads is in the log. A plan is none of them, `build_cycle` takes it as it is.

    Raises LogError where the configuration names a file that the log does not carry.
    """
    changes: dict[str, Any] = {}
    for name, section, key, kind, _ in NAMED_FILES:
        settings = getattr(configuration, section)
        if not isinstance(settings, kind):
            continue
        if name not in files:
            raise LogError(
                f"the configuration in the log names a file in {section}.{key}, and the log does not carry "
                f"it (attachment {name}): replay reads nothing else from the disk"
            )
        path = folder.absolute() / name
        path.write_bytes(files[name])
        changes[section] = settings.model_copy(update={key: str(path)})
    return configuration.model_copy(update=changes)
