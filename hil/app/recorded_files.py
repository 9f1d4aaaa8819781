"""Files attached to a log, in place of the files that its configuration refers to."""

import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from drivers.errors import LogError
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.controller_file import controller_path
from hil.app.configuration.feedforward_file import feedforward_path
from hil.config.feedforward import FeedforwardSettings
from hil.config.reference import SampledReference
from hil.control.state_space import StateSpaceSettings

REFERENCE_CSV = "reference.csv"
"""Attachment of a log: the samples of its reference."""
CONTROLLER_FILE = "controller.yaml"
"""Attachment of a log: the controller of law `state_space`."""
FEEDFORWARD_CSV = "feedforward.csv"
"""Attachment of a log: the learned feed-forward."""
REFERENCE_PLAN = "reference.npy"
"""Attachment of a log: the polynomials of a planned reference."""
NAMED_FILES: tuple[tuple[str, str, str, type[Any], Callable[[Any, Path], Path]], ...] = (
    (REFERENCE_CSV, "reference", "path", SampledReference, lambda settings, folder: folder / settings.path),
    (CONTROLLER_FILE, "controller", "controller_file", StateSpaceSettings, controller_path),
    (FEEDFORWARD_CSV, "feedforward", "file", FeedforwardSettings, feedforward_path),
)
"""Name in a log, section, key, type of settings and path of each file that a configuration may refer to."""


def sensor_files(configuration: Configuration) -> dict[str, str]:
    """Roles of sensors whose device refers to a DBC file, and the name of that file in a log."""
    roles = {role: settings for role, settings in configuration.sensors if settings is not None}
    return {role: f"sensors.{role}.dbc" for role, each in roles.items() if hasattr(each.device, "file")}


@contextmanager
def attached(configuration: Configuration, files: Mapping[str, bytes]) -> Iterator[Configuration]:
    """Yield a configuration whose files come from a log, in a temporary folder; unchanged without files.

    Raises LogError, as `with_attachments`; OSError where the temporary folder cannot be written.
    """
    named = any(isinstance(getattr(configuration, section), kind) for _, section, _, kind, _ in NAMED_FILES)
    if not named and not sensor_files(configuration):
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

    def written(name: str, where: str) -> str:
        if name not in files:
            raise LogError(
                f"the configuration in the log refers to a file in {where} that the log does not carry "
                f"(attachment {name}): replay reads no other file"
            )
        path = folder.absolute() / name
        path.write_bytes(files[name])
        return str(path)

    changes: dict[str, Any] = {}
    for name, section, key, kind, _ in NAMED_FILES:
        settings = getattr(configuration, section)
        if isinstance(settings, kind):
            changes[section] = settings.model_copy(update={key: written(name, f"{section}.{key}")})
    sensors = {}
    for role, name in sensor_files(configuration).items():
        settings = getattr(configuration.sensors, role)
        device = settings.device.model_copy(update={"file": written(name, f"sensors.{role}.device.file")})
        sensors[role] = settings.model_copy(update={"device": device})
    if sensors:
        changes["sensors"] = configuration.sensors.model_copy(update=sensors)
    return configuration.model_copy(update=changes)
