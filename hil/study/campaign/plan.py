"""The rows of a campaign: read from its file, tried before anything runs, and told from every other's."""

import hashlib
import importlib.resources
import json
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, replace
from difflib import get_close_matches
from importlib.metadata import version
from itertools import product
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

from drivers.errors import ConfigurationError
from hil.app.check.command import refuse_unreachable
from hil.app.configuration.changes import merged, text_of
from hil.app.configuration.configuration import loads, short_name
from hil.app.configuration.section_file import read_section
from hil.app.configuration.text_file import read_configuration
from hil.app.configuration.yaml_positions import Document, Problem, lines, parse
from hil.app.configuration.yaml_positions import Path as Place
from hil.config.running import RecordingSettings
from hil.study.campaign.figures import METRICS
from hil.study.campaign.keys import SEED, keys
from hil.study.campaign.keys import path as key_path
from hil.study.campaign.named_files import digests, find_beside
from hil.study.campaign.row import Job, Subject, bare, row_configuration, row_seed
from hil.study.campaign.sampling import draw, ends
from hil.study.campaign.settings import CampaignSettings, Limit, ListedAxis, SampledAxis, entries

Values = dict[str, Any]
OWN_COLUMNS = ("row", "seed", "passed", "ended", "ended_s", "faults", "trouble")
"""Columns of the table beside axes and metrics."""
MOST_ROWS = 10_000_000


@dataclass(frozen=True)
class Plan:
    """What a campaign runs: every sample with every row of the list and every combination of the grid."""

    path: Path
    """As the user has named it."""
    settings: CampaignSettings
    subject: Subject
    samples: list[tuple[Any, ...]]
    listed: list[tuple[Any, ...]]
    combinations: list[tuple[Any, ...]]

    @property
    def name(self) -> str:
        """Of the campaign."""
        return self.settings.name or short_name(self.path)

    @property
    def folder(self) -> Path:
        """Where its results go by default: beside the logs of the configuration."""
        given = self.subject.base.get("recording", {}).get("folder", RecordingSettings().folder)
        return Path(given) / f"{self.name}-campaign"

    def __len__(self) -> int:
        return len(self.samples) * len(self.listed) * len(self.combinations)

    def values(self, row: int) -> Values:
        """Return the value of each axis in a row; options and faults by name."""
        rest, k = divmod(row, len(self.combinations))
        sample, j = divmod(rest, len(self.listed))
        given = (*self.samples[sample], *self.listed[j], *self.combinations[k])
        return dict(zip(self.subject.axes, given, strict=True))

    def job(self, row: int) -> Job:
        """Return what runs a row."""
        values = self.values(row)
        sample = row // (len(self.combinations) * len(self.listed))
        return Job(self.subject, row, values, row_seed(self.subject.axes, values, sample))


def read_plan(path: Path) -> Plan:
    """Read a campaign and try each of its values on the configuration, one axis after the other.

    Raises ConfigurationError with all problems found, each with its place in the file.
    """
    file = campaign_file(path)
    settings, document = read_section(file, CampaignSettings)
    found = [
        *_named_twice(settings), *_swept_twice(settings), *_unknown_metrics(settings), *_too_many(settings),
    ]  # fmt: skip
    if found:
        raise ConfigurationError(*lines(_placed(document, found), str(file)))
    subject = _subject(file, settings, document)
    plan = Plan(
        path,
        settings,
        subject,
        [()] if settings.sample is None else draw(settings.sample),
        list(zip(*(entries(axis) for axis in (settings.list or {}).values()), strict=True)) or [()],
        list(product(*(entries(axis) for axis in (settings.grid or {}).values()))),
    )
    _try(plan, document, file)
    files = digests(subject.base, subject.axes, subject.folder, subject.campaign_folder, subject.here)
    return replace(plan, subject=subject._replace(files=files))


def shipped() -> tuple[str, ...]:
    """Return the names of the campaigns that come with the product."""
    files = importlib.resources.files("configs").joinpath("campaigns").iterdir()
    return tuple(sorted(f.name.removesuffix(".yaml") for f in files if f.name.endswith(".yaml")))


def campaign_file(path: Path) -> Path:
    """Return the file of a campaign, or of a shipped one by its name. Raises ConfigurationError: no file."""
    if path.exists() and not (path.is_dir() and str(path) in shipped()):
        return path
    if str(path) not in shipped():
        raise ConfigurationError(f"{path}: no such file; shipped campaigns are: {', '.join(shipped())}")
    return Path(str(importlib.resources.files("configs") / "campaigns" / f"{path}.yaml"))


def _named_twice(settings: CampaignSettings) -> Iterator[tuple[Place, str]]:
    seen: set[str] = set()
    for place, axes in _sections(settings):
        for name in axes:
            if name in seen or name in METRICS or name in OWN_COLUMNS:
                what = "another axis" if name in seen else "a column of the table"
                yield (*place, name), f"is the name of {what}, allowed: a name of its own"
            seen.add(name)


def _swept_twice(settings: CampaignSettings) -> Iterator[tuple[Place, str]]:
    owners: dict[Place, str] = {}
    for place, axes in _sections(settings):
        for name, axis in axes.items():
            for key in keys(axis):
                try:
                    where = key_path(key)
                except ConfigurationError:
                    continue  # said where its values are tried
                if where in owners:
                    message = f"{key} is swept by {owners[where]}, too, allowed: one axis for each key"
                    yield (*place, name), message
                owners.setdefault(where, name)


def _too_many(settings: CampaignSettings) -> Iterator[tuple[Place, str]]:
    """Refuse more rows than MOST_ROWS, before any is made."""
    samples = 1 if settings.sample is None else settings.sample.count
    listed = [len(entries(axis)) for axis in (settings.list or {}).values()][:1]  # they have equally many
    grid = [len(entries(axis)) for axis in (settings.grid or {}).values()]
    rows = prod([samples, *listed, *grid])
    if rows > MOST_ROWS:
        yield (
            ("grid" if grid else "list",),
            f"{rows} rows, allowed: up to {MOST_ROWS} of sample, list and grid",
        )


def _unknown_metrics(settings: CampaignSettings) -> Iterator[tuple[Place, str]]:
    for name in settings.limits:
        if name not in METRICS:
            near = get_close_matches(name, METRICS, 1, 0.6)
            guess = f"did you mean {near[0]}? " if near else ""
            yield ("limits", name), f"unknown metric, {guess}allowed: {', '.join(METRICS)}"
        elif name == "travel_mm" and settings.after_fault == "end":
            yield (
                ("limits", name),
                "not measured in runs that end with their fault, allowed: with after_fault: rest",
            )


def _sections(settings: CampaignSettings) -> Iterator[tuple[Place, dict[str, ListedAxis]]]:
    if settings.sample is not None:
        yield ("sample", "axes"), dict(settings.sample.axes)
    yield ("list",), settings.list or {}
    yield ("grid",), settings.grid or {}


def _placed(document: Document, found: list[tuple[Place, str]]) -> list[Problem]:
    return [Problem(document.key_position(place), place, message) for place, message in found]


def _subject(path: Path, settings: CampaignSettings, document: Document) -> Subject:
    """Return what all rows share; the configuration with the campaign's changes has to be valid itself."""
    beside = path.parent / settings.configuration
    try:
        file, text = read_configuration(beside if beside.is_file() else settings.configuration)
        loads(text, str(file), file.parent)
        base = merged({"name": short_name(file)} | (parse(text).value or {}), settings.changes)
        name = f"{file} with the changes of the campaign"
        folder, campaign_folder = file.parent.absolute(), path.parent.absolute()
        whole = deepcopy(base)
        find_beside(whole, folder, campaign_folder, Path.cwd())
        refuse_unreachable(loads(text_of(whole), name, folder))
    except ConfigurationError as error:
        place: Place = ("changes",) if settings.changes else ("configuration",)
        found = [(place, bare(problem)) for problem in error.problems]
        raise ConfigurationError(*lines(_placed(document, found), str(path))) from None
    return Subject(
        base=base,
        source=str(file),
        folder=folder,
        campaign_folder=campaign_folder,
        here=Path.cwd(),
        axes={name: axis for _, axes in _sections(settings) for name, axis in axes.items()},
        limits={"faulted": Limit(max=0.0)} | settings.limits,
        duration_s=settings.duration_s,
        parks=settings.until == "parked",
        rests=settings.after_fault == "rest",
    )


class _Try(NamedTuple):
    """A row in which some axes take a value while the others keep their first."""

    place: Place
    axes: list[str]
    values: Values


def _tries(plan: Plan) -> Iterator[_Try]:
    """Yield a row for each value of each axis, for both ends of a range, for each row of the list."""
    first = plan.values(0)
    for place, axes in _sections(plan.settings):
        if place == ("list",) and axes:
            for given in plan.listed:
                yield _Try(place, list(axes), first | dict(zip(axes, given, strict=True)))
            continue
        for name, axis in axes.items():
            for value in ends(axis) if isinstance(axis, SampledAxis) else entries(axis):
                own: Place = (*place, name)
                if axis.values is None and entries(axis):  # these have names, and places of their own
                    own = (*own, "faults" if axis.options is None else "options", value)
                yield _Try(own, [name], first | {name: value})


def _try(plan: Plan, document: Document, file: Path) -> None:
    """Refuse values that the configuration cannot have, with all that is wrong with them."""
    found: dict[tuple[Place, str], None] = {}
    for place, own, values in _tries(plan):
        alone = plan.subject._replace(axes={name: plan.subject.axes[name] for name in own})
        problems = _problems(alone, values)
        if problems and _problems(plan.subject, values):  # it may need what another axis brings
            found |= dict.fromkeys((place, problem) for problem in problems)
    if found:
        raise ConfigurationError(*lines(_placed(document, list(found)), str(file)))


def _problems(subject: Subject, values: Values) -> list[str]:
    """Return what is wrong with a row of these axes."""
    try:
        row_configuration(Job(subject, 0, values, _seed(subject, values)))
    except ConfigurationError as error:
        return [bare(problem) for problem in error.problems]
    return []


def _seed(subject: Subject, values: Values) -> int:
    for name, axis in subject.axes.items():
        if SEED not in keys(axis):
            continue
        if type(value := values[name]) is not int or not 0 <= value < 2**63:  # the table has 64 bits for it
            raise ConfigurationError(f"{SEED}: allowed: whole numbers from 0 to 2**63 - 1, given: {value!r}")
    return row_seed(subject.axes, values, 0)


def identity(plan: Plan) -> dict[str, str]:
    """Return what tells a campaign from every other, by what it is made of: digests, and the version.

    The same identity, the same table. Comments in its file and where the files lie make no difference.
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
        name = f"file {Path(file).name}"  # wherever it lies; files of one name are told by their order
        found[name] = " ".join(filter(None, (found.get(name), digest)))
    return found


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value).encode()).hexdigest()
