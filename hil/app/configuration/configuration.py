"""Configuration: one YAML file composed of each package's own sections.

Every problem of a file is reported at once, each as `file:line:column: path: what, allowed, given`.
"""

import json
import re
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PrivateAttr, ValidationError, create_model
from pydantic.fields import FieldInfo

from drivers.config import BusSettings, DriveSettings, SensorSettings
from drivers.errors import ConfigurationError
from drivers.section import Section
from hil.app.configuration import problems as translate
from hil.app.configuration.compare import CompareSettings
from hil.app.configuration.consistency import RULES, needs
from hil.app.configuration.fault_rules import cannot_serve
from hil.app.configuration.law_file import LawFile, UnreadLaw, is_file, read_law, run_law
from hil.app.configuration.magnitudes import beyond_reason
from hil.app.configuration.plant_step import fitted
from hil.app.configuration.text_file import read_configuration
from hil.app.configuration.yaml_positions import Document, Position, Problem, lines, parse
from hil.config.estimation import EstimationSettings
from hil.config.feedforward import FeedforwardSettings
from hil.config.limits import LimitSettings
from hil.config.loop import LoopSettings
from hil.config.monitor import MonitorSettings
from hil.config.operator import OperatorSettings
from hil.config.platform import PlatformSettings
from hil.config.reactions import ReactionSettings
from hil.config.reference import ReferenceSettings
from hil.config.running import EngageSettings, RecordingSettings
from hil.config.watch import WatchSettings
from hil.control import ControllerSettings
from hil.control.law import LawSettings
from plant_fmu.config import PlantSettings

Command = Literal["run", "plant", "sim", "replay", "check"]


class Configuration(Section):
    """Robot, bus, drives, controller, what to do, what to refuse."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]{1,100}$")] = ""
    """Short name, used in log file names; default is the file's name, other signs as _."""
    description: str = ""
    """What this configuration is, in a sentence or two."""
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
    """Leg forces that earlier runs of the reference have taught; `hil learn` makes them."""
    limits: LimitSettings
    reactions: ReactionSettings = ReactionSettings()
    recording: RecordingSettings = RecordingSettings()
    watch: WatchSettings = WatchSettings()
    plant: PlantSettings | None = None
    """The other end of a virtual bus; left out for real drives."""
    compare: CompareSettings = CompareSettings()
    """What `hil compare` compares; no other command reads it."""

    _text: str = PrivateAttr("")
    _source: str = PrivateAttr("")
    _folder: Path = PrivateAttr(Path())
    _law_file: LawFile | None = PrivateAttr(None)

    @property
    def text(self) -> str:
        """The exact source text, for the log."""
        return self._text

    @property
    def source(self) -> str:
        """The file as the user named it."""
        return self._source

    @property
    def folder(self) -> Path:
        """Base of relative paths."""
        return self._folder

    @property
    def law_file(self) -> LawFile | None:
        """The file of a law in one file."""
        return self._law_file

    def with_law(self, file: LawFile) -> "Configuration":
        """Return the configuration of a log with the law that its section `controller` belongs to; it is run.

        Raises ConfigurationError where the law refuses the keys of this section.
        """
        settings = run_law(self.controller.law, file)
        try:
            controller = settings.model_validate_json(self.controller.model_dump_json(), strict=True)
        except ValidationError as error:
            raise ConfigurationError(f"{file.path}: refuses section controller of the log: {error}") from None
        changed = self.model_copy(update={"controller": controller})
        changed._law_file = file  # noqa: SLF001
        return changed

    def require(self, command: Command) -> None:
        """Refuse what cannot serve `command`.

        Raises ConfigurationError: `virtual` interface between two processes, layout `ideal` on a real bus,
        no section `plant` where one is needed, faults that the command cannot bring about.
        """
        found = []
        if command in ("run", "plant") and any(each.interface == "virtual" for each in self.bus.buses):
            found.append(
                f"{self._source}: bus.interface: python-can's `virtual` bus lives inside one process, and "
                f"`hil {command}` is one end of a bus between two; use localcan here, or `hil sim`"
            )
        if command in ("run", "plant") and self.bus.layout == "ideal":
            found.append(
                f"{self._source}: bus.layout: `ideal` is for theory: it takes no bus time and exists only in "
                f"lockstep; use `hil sim`, or layout classic or fd for `hil {command}`"
            )
        if command in ("plant", "sim") and self.plant is None:
            found.append(
                f"{self._source}: plant: missing, and `hil {command}` needs one: this configuration is for "
                "real drives (`hil run`)"
            )
        faults = [] if self.plant is None else self.plant.faults
        found += [f"{self._source}: {problem}" for problem in cannot_serve(command, faults)]
        if found:
            raise ConfigurationError(*found)

    def require_live(self) -> None:
        """Raise ConfigurationError for a reference that takes no set-points."""
        if self.reference.type != "live":
            raise ConfigurationError(
                f"{self._source}: reference.type: {self.reference.type} takes no set-points, allowed: live"
            )


def short_name(path: str | Path) -> str:
    """Return the name that a configuration has where it gives none: its file's, other signs as _."""
    return re.sub(r"[^A-Za-z0-9._-]", "_", Path(path).stem)[:100] or "_"


@cache
def json_schema() -> dict[str, Any]:
    """Return the schema of a whole configuration. Not to be changed."""
    return Configuration.model_json_schema()


_ALONE: dict[str, type[Section]] = {
    field: create_model(field, __base__=Section, **{field: (info.annotation, info)})  # type: ignore[call-overload]
    for field, info in Configuration.model_fields.items()
}
"""Each section as a model of its own: one that is wrong must not hide what is wrong in another."""


def load(path: str | Path) -> Configuration:
    """Read a configuration from a file, or by the name of a shipped one (`virtual`).

    Raises ConfigurationError with all problems found.
    """
    file, text = read_configuration(path)
    return loads(text, str(file), file.parent)


def loads(text: str, name: str = "<text>", folder: Path | None = None) -> Configuration:
    """Read a configuration from text; `name` stands for the file in messages.

    Without `folder`, files that the configuration names (CSV, FMU, a law's) are not looked for.
    Raises ConfigurationError with all problems found.
    """
    document = parse(text)
    found = list(document.problems)
    sections: dict[str, Any] = {}
    file = None
    if document.value is not None:
        file, law = _law(document, folder, found)
        for field, info in Configuration.model_fields.items():
            kind = law if field == "controller" and law is not None else _ALONE[field]
            sections |= _section(field, info, document, found, kind)
        found += _unknown_sections(document)
        told = {problem.path for problem in found}
        absurd = [problem for problem in beyond_reason(document) if problem.path not in told]
        found += absurd
        if not absurd:
            found += _together(sections, document, folder)
    if found:
        raise ConfigurationError(*lines(found, name))
    # Each section is valid already, and the union of `controller` does not know a law in a file.
    configuration = Configuration.model_construct(**({"name": short_name(name)} | sections))
    configuration._text, configuration._source, configuration._folder = text, name, folder or Path()  # noqa: SLF001
    configuration._law_file = file  # noqa: SLF001
    return configuration


def _together(sections: dict[str, Any], document: Document, folder: Path | None) -> list[Problem]:
    """Fit the plant's step to the loop, and return what does not fit between sections."""
    plant, loop = sections.get("plant"), sections.get("loop")
    if plant is not None and loop is not None:
        sections["plant"] = fitted(plant, loop)
    if isinstance(sections.get("controller"), UnreadLaw):  # nothing of it is known; its run was checked
        sections = {name: section for name, section in sections.items() if name != "controller"}
    return [
        Problem(document.value_position(path), path, message)
        for rule in RULES
        if all(name in sections for name in needs(rule))
        for path, message in rule(*(sections[name] for name in needs(rule)), folder)
    ]


def _law(
    document: Document, folder: Path | None, found: list[Problem]
) -> tuple[LawFile | None, type[Section] | None]:
    """Return the file of a law in a file, and section `controller` of that law as a model of its own.

    Without a folder the configuration is that of a log: its law stays unread.
    """
    section = (document.value or {}).get("controller")
    law = section.get("law") if isinstance(section, dict) else None
    if not is_file(law):
        return None, None
    file: LawFile | None = None
    settings: type[LawSettings] = UnreadLaw
    try:
        if folder is not None:
            file, settings = read_law(law, folder)
    except ConfigurationError as error:
        place = ("controller", "law")
        found.append(Problem(document.value_position(place), place, str(error)))
    return file, create_model("controller", __base__=Section, controller=(settings, ...))


def _section(
    field: str, info: FieldInfo, document: Document, found: list[Problem], kind: type[Section]
) -> dict[str, Any]:
    """Validate one section; a missing one with a default is not in the result's text but is valid."""
    assert document.value is not None
    if field not in document.value:
        if not info.is_required():
            return {} if field == "name" else {field: info.get_default()}
        allowed = translate.describe(translate.at((field,), None, json_schema()), json_schema())
        found.append(Problem(Position(1, 1), (field,), f"missing, allowed: {allowed}"))
        return {}
    text = json.dumps({field: document.value[field]})
    try:
        # JSON, because its strict mode takes a list for a tuple but no text and no boolean for a number.
        return {field: getattr(kind.model_validate_json(text, strict=True), field)}
    except ValidationError as error:
        already = {p.path for p in document.problems}
        schema = json_schema() if kind is _ALONE[field] else kind.model_json_schema()
        for problem in translate.problems(error, document, schema):
            if problem.path not in already:
                found.append(problem)
        return {}


def _unknown_sections(document: Document) -> list[Problem]:
    assert document.value is not None
    return [
        Problem(document.key_position((key,)), (key,), translate.unknown_key((key,), document, json_schema()))
        for key in document.value
        if key not in Configuration.model_fields
    ]
