"""The configuration: one YAML file composed of the sections of each package.

All problems of a file are reported at once, each as `file:line:column: path: what, allowed, given`.
"""

import json
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PrivateAttr, ValidationError, ValidationInfo, create_model, field_validator

from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError
from drivers.section import Section
from drivers.sensing.dbc import with_dbc
from drivers.sensing.settings import SensorSettings
from hil.app.configuration.bounds import fitted
from hil.app.configuration.compare import CompareSettings
from hil.app.configuration.fault_rules import cannot_serve
from hil.app.configuration.law_file import LawFile, UnreadLaw, is_file, read_law, run_law
from hil.app.configuration.problems import problems
from hil.app.configuration.rules import broken
from hil.app.configuration.text_file import read_configuration
from hil.app.configuration.yaml_positions import Document, Problem, lines, parse
from hil.config.estimation import EstimationSettings
from hil.config.feedforward import FeedforwardSettings
from hil.config.limits import LimitSettings, MonitorSettings, ReactionSettings
from hil.config.number import LEAST, MOST
from hil.config.platform import PlatformSettings
from hil.config.reference import ReferenceSettings
from hil.config.running import (
    EngageSettings,
    LoopSettings,
    OperatorSettings,
    RecordingSettings,
    WatchSettings,
)
from hil.control import ControllerSettings
from hil.control.law import LawSettings
from plant_fmu.config import PlantSettings

NO_LIMIT, MOST_SEED = 1e30, 2**64
"""Largest number in section `limits`, where a large number stands for no limit; largest seed."""
Command = Literal["run", "plant", "sim", "replay", "check"]


class Configuration(Section):
    """Whole configuration: robot, bus, drives, controller, reference, limits."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]{1,100}$")] = ""
    """Short name for log files; default: the name of the file, with _ for other characters."""
    description: str = ""
    """Description of this configuration in a sentence or two."""
    platform: PlatformSettings
    bus: BusSettings
    drives: DriveSettings = DriveSettings()
    sensors: SensorSettings = SensorSettings()
    loop: LoopSettings = LoopSettings()
    estimation: EstimationSettings = EstimationSettings()
    controller: ControllerSettings
    monitor: MonitorSettings = MonitorSettings()
    engage: EngageSettings = EngageSettings()
    operator: OperatorSettings = OperatorSettings()
    reference: ReferenceSettings
    feedforward: FeedforwardSettings | None = None
    """Leg forces learned from earlier runs of the reference; `hil learn` writes them."""
    limits: LimitSettings
    reactions: ReactionSettings = ReactionSettings()
    recording: RecordingSettings = RecordingSettings()
    watch: WatchSettings = WatchSettings()
    plant: PlantSettings | None = None
    """The other end of a virtual bus; leave it out for real drives."""
    compare: CompareSettings = CompareSettings()
    """Settings of `hil compare`; no other command reads them."""

    _text: str = PrivateAttr("")
    _source: str = PrivateAttr("")
    _folder: Path = PrivateAttr(Path())
    _files: Mapping[str, bytes] = PrivateAttr({})
    _law_file: LawFile | None = PrivateAttr(None)

    @field_validator("*")
    @classmethod
    def _is_valid(cls, value: Any, info: ValidationInfo) -> Any:
        """Pass a valid section to `loads`: an invalid section must not hide problems of the others."""
        if info.context is not None:
            info.context[info.field_name] = value
        return value

    @property
    def text(self) -> str:
        """Exact source text of the configuration, which a log stores."""
        return self._text

    @property
    def source(self) -> str:
        """Path or name of the configuration file as given by the user."""
        return self._source

    @property
    def folder(self) -> Path:
        """Folder to which relative paths in the configuration refer."""
        return self._folder

    @property
    def files(self) -> Mapping[str, bytes]:
        """Files of the log that contains the configuration, by name; else empty."""
        return self._files

    @property
    def law_file(self) -> LawFile | None:
        """Python file of the control law, for `controller.law: FILE.py:CLASS`; else None."""
        return self._law_file

    def with_law(self, file: LawFile) -> "Configuration":
        """Configuration of a log with the law of its section `controller`; the law's file is run.

        Raises ConfigurationError if the law refuses the keys of this section.
        """
        settings = run_law(self.controller.law, file)
        try:
            controller = settings.model_validate_json(self.controller.model_dump_json(), strict=True)
        except ValidationError as error:
            raise ConfigurationError(
                f"{file.path}: the law refuses section controller of the log: {error}"
            ) from None
        changed = self.model_copy(update={"controller": controller})
        changed._law_file = file  # noqa: SLF001
        return changed

    def require(self, command: Command) -> None:
        """Check that the configuration is usable for `command`.

        Raises ConfigurationError: `virtual` interface between two processes, layout `ideal` on a real bus, no
        section `plant` where one is needed, faults that the command cannot produce.
        """
        found: list[str] = []
        if command in ("run", "plant") and any(each.interface == "virtual" for each in self.bus.buses):
            found.append(
                "bus.interface: python-can's `virtual` bus exists inside one process only, but "
                f"`hil {command}` needs a bus between two processes; use localcan, or `hil sim`"
            )
        if command in ("run", "plant") and self.bus.layout == "ideal":
            found.append(
                "bus.layout: `ideal` takes no bus time and exists only in lockstep; use "
                f"`hil sim`, or layout classic or fd for `hil {command}`"
            )
        if command in ("plant", "sim") and self.plant is None:
            found.append(
                f"plant: missing, but `hil {command}` needs it: this configuration is for real drives "
                "(`hil run`)"
            )
        found += cannot_serve(command, [] if self.plant is None else self.plant.faults)
        if found:
            raise ConfigurationError(*(f"{self._source}: {problem}" for problem in found))

    def require_live(self) -> None:
        """Raise ConfigurationError if the reference takes no set-points, i.e. is not `live`."""
        if self.reference.type != "live":
            raise ConfigurationError(
                f"{self._source}: reference.type: {self.reference.type} takes no set-points, allowed: live"
            )


def short_name(path: str | Path) -> str:
    """Default name of a configuration: the name of its file, with _ for other characters."""
    return re.sub(r"[^A-Za-z0-9._-]", "_", Path(path).stem)[:100] or "_"


@cache
def json_schema() -> dict[str, Any]:
    """JSON Schema of a whole configuration; cached, so callers must not change it."""
    return Configuration.model_json_schema()


def load(path: str | Path) -> Configuration:
    """Read a configuration from a file, or a shipped one by its name, e.g. `virtual`.

    Raises ConfigurationError with all problems found.
    """
    file, text = read_configuration(path)
    return loads(text, str(file), file.parent)


def loads(
    text: str, name: str = "<text>", folder: Path | None = None, files: Mapping[str, bytes] | None = None
) -> Configuration:
    """Read a configuration from text; `name` stands for the file in messages.

    Without `folder`, files of the configuration (CSV, FMU, law) are not read; the DBC of the drives comes
    from `files`, the attachments of a log. Raises ConfigurationError with all problems found.
    """
    document = parse(text)
    found = list(document.problems)
    sections: dict[str, Any] = {}
    file, kind = _law(document, folder, found)
    if document.value is not None:
        reported = {problem.path for problem in found}
        try:
            # JSON: its strict mode accepts a list as a tuple, but neither text nor a boolean as a number.
            kind.model_validate_json(json.dumps(document.value), strict=True, context=sections)
        except ValidationError as error:
            schema = json_schema() if kind is Configuration else kind.model_json_schema()
            found += [each for each in problems(error, document, schema) if each.path not in reported]
        for field, info in Configuration.model_fields.items():
            if field not in document.value and not info.is_required():
                sections[field] = info.get_default() if field != "name" else short_name(name)
        reported = {problem.path for problem in found}
        out_of_range = [problem for problem in _out_of_range(document) if problem.path not in reported]
        if "drives" in sections:
            sections["drives"] = with_dbc(sections["drives"], folder, files or {})
        found += out_of_range or _between_sections(sections, document, folder)
    if found:
        raise ConfigurationError(*lines(found, name))
    # All sections are valid already, and the union of `controller` does not include a law in a file.
    configuration = Configuration.model_construct(**sections)
    configuration._text, configuration._source, configuration._folder = text, name, folder or Path()  # noqa: SLF001
    configuration._law_file, configuration._files = file, files or {}  # noqa: SLF001
    return configuration


def _between_sections(sections: dict[str, Any], document: Document, folder: Path | None) -> list[Problem]:
    """Fit the plant's step to the loop, and return the problems between sections."""
    plant, loop = sections.get("plant"), sections.get("loop")
    if plant is not None and loop is not None:
        sections["plant"] = fitted(plant, loop)
    if isinstance(
        sections.get("controller"), UnreadLaw
    ):  # its keys are unknown; they were checked for its run
        sections = {name: section for name, section in sections.items() if name != "controller"}
    found = broken(sections, folder)
    return [Problem(document.value_position(path), path, message) for path, message in found]


def _out_of_range(document: Document) -> list[Problem]:
    """Problems of numbers beyond the allowed magnitudes, whose squares would not fit into a float.

    Parameters of a custom FMU may have any magnitude.
    """
    found = []
    for path, position in document.values.items():
        value: Any = document.at(path)
        most = MOST_SEED if path[-1] == "seed" else NO_LIMIT if path[0] == "limits" else MOST
        number = isinstance(value, int | float) and path[:3] != ("plant", "model", "parameters")
        if number and value and not LEAST <= abs(value) <= most:
            message = f"allowed magnitude: 0, and {LEAST:g} to {most:g}, given: {float(value):g}"
            found.append(Problem(position, path, message))
    return found


def _law(
    document: Document, folder: Path | None, found: list[Problem]
) -> tuple[LawFile | None, type[Configuration]]:
    """(law file or None, configuration class) for a document whose law is in a Python file.

    Without a folder the configuration comes from a log, so the law's file is not read.
    """
    section = (document.value or {}).get("controller")
    law = section.get("law") if isinstance(section, dict) else None
    if not is_file(law):
        return None, Configuration
    file: LawFile | None = None
    settings: type[LawSettings] = UnreadLaw
    try:
        if folder is not None:
            file, settings = read_law(law, folder)
    except ConfigurationError as error:
        place = ("controller", "law")
        found.append(Problem(document.value_position(place), place, str(error)))
    return file, create_model("WithLawInFile", __base__=Configuration, controller=(settings, ...))
