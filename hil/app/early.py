"""What is refused before anything is compiled: files that could not be written. Light imports only."""

import os
from pathlib import Path

from drivers.errors import LogError
from hil.app.configuration.text_file import read_configuration
from hil.app.configuration.yaml_positions import parse
from hil.config.running import RecordingSettings


def refuse_folder(folder: Path, mend: str) -> None:
    """Refuse a folder that can neither be written nor made; mend: what to do then. Makes none.

    Raises LogError.
    """
    above = folder
    while not os.path.lexists(above) and above != above.parent:
        above = above.parent
    if not above.is_dir():
        why = (
            "is a link to nothing" if above.is_symlink() and not above.exists() else "is a file and no folder"
        )
        raise LogError(f"{above}: {why}; {mend}")
    if not os.access(above, os.W_OK | os.X_OK):
        why = "no right to write there"
        if above != folder:
            why = f"cannot be made, as there is no right to write in {above.absolute()}"
        raise LogError(f"{folder}: {why}; {mend}")


def refuse_log_folder(configuration: str, log: Path | None) -> None:
    """Refuse a log, `--log` or one in the folder of a configuration, that could not be written.

    Raises LogError, ConfigurationError: there is no such configuration.
    """
    if log is not None:
        refuse_folder(log.parent, "name another file with --log")
        return
    folder = recordings(configuration)
    if folder is not None:
        refuse_folder(folder, "name another file with --log, or set recording.folder")


def recordings(configuration: str) -> Path | None:
    """Return the folder of logs that a configuration states; None where that is wrong, which others say."""
    section = (parse(read_configuration(configuration)[1]).value or {}).get("recording") or {}
    default = RecordingSettings.model_fields["folder"].default
    folder = section.get("folder", default) if isinstance(section, dict) else None
    return Path(folder) if isinstance(folder, str) else None
