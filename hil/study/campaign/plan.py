"""Rows of a campaign: read from the campaign file and checked before any run; digests identify them."""

import hashlib
import importlib.resources
import json
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Any

from drivers.errors import ConfigurationError
from hil.app.check.command import refuse_unreachable
from hil.app.configuration.changes import merged, text_of
from hil.app.configuration.configuration import loads, short_name
from hil.app.configuration.section_file import read_section
from hil.app.configuration.text_file import read_configuration
from hil.app.configuration.yaml_positions import Document, Problem, lines, parse
from hil.app.configuration.yaml_positions import Path as Place
from hil.config.running import RecordingSettings
from hil.study.campaign.named_files import digests, find_beside
from hil.study.campaign.row import Job, Subject, bare, row_configuration, row_seed
from hil.study.campaign.settings import CampaignSettings

Values = dict[str, Any]


@dataclass(frozen=True)
class Plan:
    """Rows of a campaign: every sample with every row of the list and every combination of the grid."""

    path: Path
    """Path as given by the user."""
    subject: Subject
    samples: list[tuple[Any, ...]]
    listed: list[tuple[Any, ...]]
    combinations: list[tuple[Any, ...]]

    @property
    def settings(self) -> CampaignSettings:
        """Settings from the campaign file."""
        return self.subject.settings

    @property
    def name(self) -> str:
        """Name of the campaign."""
        return self.settings.name or short_name(self.path)

    @property
    def folder(self) -> Path:
        """Default folder of the results, next to the logs of the configuration."""
        given = self.subject.base.get("recording", {}).get("folder", RecordingSettings().folder)
        return Path(given) / f"{self.name}-campaign"

    def __len__(self) -> int:
        return len(self.samples) * len(self.listed) * len(self.combinations)

    def values(self, row: int) -> Values:
        """Value of each axis in a row, by axis; options and faults by their names."""
        rest, k = divmod(row, len(self.combinations))
        sample, j = divmod(rest, len(self.listed))
        given = (*self.samples[sample], *self.listed[j], *self.combinations[k])
        return dict(zip(self.settings.axes, given, strict=True))

    def job(self, row: int) -> Job:
        """Everything needed to run a row."""
        values = self.values(row)
        sample = row // (len(self.combinations) * len(self.listed))
        return Job(self.subject, row, values, row_seed(self.settings, values, sample))


def read_plan(path: Path) -> Plan:
    """Read a campaign file and check each axis value with the configuration, one axis after the other.

    Raises ConfigurationError with all problems, each with its place in the file.
    """
    file = campaign_file(path)
    settings, document = read_section(file, CampaignSettings)
    subject = _subject(file, settings, document)
    plan = Plan(
        path,
        subject,
        [()] if settings.sample is None else settings.sample.draw(),
        list(zip(*(axis.entries for axis in (settings.list or {}).values()), strict=True)) or [()],
        list(product(*(axis.entries for axis in (settings.grid or {}).values()))),
    )
    found: dict[tuple[Place, str], None] = {}
    for place, own, values in _tries(plan):
        problems = _problems(subject, {name: values[name] for name in own})
        if problems and _problems(subject, values):  # it may depend on another axis
            found |= dict.fromkeys((place, problem) for problem in problems)
    _refuse(found, document, file)
    return replace(
        plan, subject=subject._replace(files=digests(subject.base, settings.axes, subject.folders))
    )


def shipped() -> tuple[str, ...]:
    """Names of the campaign files shipped with the package."""
    files = importlib.resources.files("configs").joinpath("campaigns").iterdir()
    return tuple(sorted(f.name.removesuffix(".yaml") for f in files if f.name.endswith(".yaml")))


def campaign_file(path: Path) -> Path:
    """Campaign file at a path or of a shipped name. Raises ConfigurationError if there is no such file."""
    if path.is_file():
        return path
    if str(path) not in shipped():
        raise ConfigurationError(f"{path}: no such file or shipped campaign; shipped: {', '.join(shipped())}")
    return Path(str(importlib.resources.files("configs") / "campaigns" / f"{path}.yaml"))


def _refuse(found: dict[tuple[Place, str], None], document: Document, file: Path) -> None:
    """Raise ConfigurationError if there are problems, each with its place in the file."""
    if found:
        placed = [Problem(document.key_position(place), place, message) for place, message in found]
        raise ConfigurationError(*lines(placed, str(file)))


def _subject(path: Path, settings: CampaignSettings, document: Document) -> Subject:
    """Read the data shared by all rows. The configuration with the campaign's changes must be valid."""
    beside = path.parent / settings.configuration
    try:
        file, text = read_configuration(beside if beside.is_file() else settings.configuration)
        loads(text, str(file), file.parent)
        base = merged({"name": short_name(file)} | (parse(text).value or {}), settings.changes)
        folders = file.parent.absolute(), path.parent.absolute(), Path.cwd()
        whole = deepcopy(base)
        find_beside(whole, folders)
        name = f"{file} with the changes of the campaign"
        refuse_unreachable(loads(text_of(whole), name, folders[0]))
    except ConfigurationError as error:
        place: Place = ("changes",) if settings.changes else ("configuration",)
        _refuse({(place, bare(problem)): None for problem in error.problems}, document, path)
        raise
    return Subject(base, str(file), folders, settings)


def _tries(plan: Plan) -> Iterator[tuple[Place, list[str], Values]]:
    """Yield trial rows that check the values of a campaign: one per axis value and per row of the list.

    Each comes with its place in the file and the names of the axes under trial; other axes keep their first
    value. Of a range both ends are tried.
    """
    first = plan.values(0)
    for section, axes in plan.settings.sections:
        place: Place = tuple(section.split("."))
        if section == "list" and axes:
            for given in plan.listed:
                yield place, list(axes), first | dict(zip(axes, given, strict=True))
            continue
        for name, axis in axes.items():
            named = () if axis.key else ("faults" if axis.options is None else "options",)
            for value in axis.ends:
                yield (*place, name, *named, *([value] if named else [])), [name], first | {name: value}


def _problems(subject: Subject, values: Values) -> list[str]:
    """Errors in the configuration of a row with these axis values, as texts; empty if valid."""
    try:
        row_configuration(Job(subject, 0, values, row_seed(subject.settings, values, 0)))
    except ConfigurationError as error:
        return [bare(problem) for problem in error.problems]
    return []


def identity(plan: Plan) -> dict[str, str]:
    """Identity of a campaign: digests of its parts, and the version.

    The same identity means the same table. Comments in the file and the location of files do not count.
    """
    drawn = hashlib.sha256()
    for row in range(len(plan)):
        drawn.update(repr(tuple(plan.values(row).items())).encode())
    found = {
        "campaign": _digest(plan.settings.model_dump(mode="json", exclude={"description"})),
        "configuration": _digest(plan.subject.base),
        "values of the rows": drawn.hexdigest(),
        "version of hexapod-hil": version("hexapod-hil"),
    }
    for file, digest in plan.subject.files.items():
        name = f"file {Path(file).name}"  # wherever it is; files of one name differ by their order
        found[name] = f"{found.get(name, '')} {digest}".strip()
    return found


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value).encode()).hexdigest()
