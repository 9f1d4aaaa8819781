"""Files attached to a log, in place of the files that its configuration refers to."""

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
    """Yield a configuration whose files come from a log, in a temporary folder; unchanged without files.

    Raises LogError, as `with_attachments`; OSError where the temporary folder cannot be written.
    """
    if not any(isinstance(getattr(configuration, section), kind) for _, section, _, kind, _ in NAMED_FILES):
        yield configuration
        return
    with tempfile.TemporaryDirectory(prefix="hil-log-files-") as folder:
        yield with_attachments(configuration, files, Path(folder))


def with_attachments(configuration: Configuration, files: Mapping[str, bytes], folder: Path) -> Configuration:
    """Configuration whose files come from a log instead of the disk; they are written to `folder`.

    Replay reads only these files, even where the product ships a file of the same name. A planned reference
    is not among them: `build_cycle` takes it directly.

    Raises LogError where the configuration refers to a file that the log does not have.
    """
    changes: dict[str, Any] = {}
    for name, section, key, kind, _ in NAMED_FILES:
        settings = getattr(configuration, section)
        if not isinstance(settings, kind):
            continue
        if name not in files:
            raise LogError(
                f"the configuration in the log refers to a file in {section}.{key} that the log does not "
                f"carry (attachment {name}): replay reads no other file"
            )
        path = folder.absolute() / name
        path.write_bytes(files[name])
        changes[section] = settings.model_copy(update={key: str(path)})
    return configuration.model_copy(update=changes)
