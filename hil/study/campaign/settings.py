"""Settings in a campaign file: the configuration, the swept keys and their values, the limits of a run."""

import json
from collections.abc import Iterator
from difflib import get_close_matches
from math import floor, inf, prod
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from drivers.section import Section
from hil.app.configuration.schema import described
from hil.app.sim.commands import LATEST_S
from hil.study.campaign.figures import METRICS

OWN_COLUMNS = ("row", "seed", "passed", "ended", "ended_s", "faults", "trouble")
"""Columns of the table other than axes and metrics."""
MOST_ROWS = 10_000_000


def _rising(ends: Any) -> Any:
    if ends[0] >= ends[1]:
        raise ValueError(f"invalid range, allowed: [low, high] with low < high, given: {list(ends)}")
    return ends


def _measured(name: str) -> str:
    if name not in METRICS:
        near = get_close_matches(name, METRICS, 1, 0.6)
        guess = f"did you mean {near[0]}? " if near else ""
        raise ValueError(f"unknown metric {name}, {guess}allowed: {', '.join(METRICS)}")
    return name


Positive = Annotated[float, Field(gt=0)]
AxisName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,49}$")]
Metric = Annotated[str, AfterValidator(_measured)]
Method = Literal["sobol", "latin_hypercube", "halton"]


class Normal(Section):
    """A normal distribution truncated at both ends."""

    mean: float
    std: Positive
    min: float
    max: float

    @model_validator(mode="after")
    def _some_width(self) -> Self:
        _rising((self.min, self.max))
        return self


class ListedAxis(Section):
    """Values of one axis: of a configuration key, or named sets of changes, or named sets of faults."""

    KINDS: ClassVar[tuple[str, ...]] = ("values", "options", "faults")

    key: str | list[str] | None = None
    """Key that takes the value: `plant.drives.encoder_resolution_m`, `plant.faults[0].mass_kg`, `seed`;
    several keys take the same value.
    """
    values: Annotated[list[Any], Field(min_length=1)] | None = None
    """Values of `key`."""
    options: Annotated[dict[str, dict[str, Any]], Field(min_length=1)] | None = None
    """Name -> changes of the configuration: laws, designs, plants, paths."""
    faults: Annotated[dict[str, list[str]], Field(min_length=1)] | None = None
    """Name -> faults added to `plant.faults`, in the words of `hil sim --fault`; `[]`: no fault."""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        given = [name for name in self.KINDS if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(
                f"allowed: exactly one of {', '.join(self.KINDS)}, given: {', '.join(given) or 'none'}"
            )
        if bool(self.key) is (given[0] in ("options", "faults")):
            raise ValueError(
                "key is missing, allowed: a key of the configuration, as plant.model.coulomb_friction_N"
                if not self.key
                else "options and faults define their own changes; allowed: no key next to them"
            )
        return self

    @property
    def targets(self) -> list[str]:
        """Configuration keys that take the value of this axis; empty for options and faults."""
        return [self.key] if isinstance(self.key, str) else self.key or []

    @property
    def entries(self) -> list[Any]:
        """Listed values, or the names of options or faults; empty for a distribution."""
        return list(self.values or self.options or self.faults or [])

    @property
    def ends(self) -> list[Any]:
        """Values checked before a campaign: all listed values, or both ends of a distribution."""
        return self.entries


class SampledAxis(ListedAxis):
    """A sampled axis: the distribution of a key, or listed values that are equally frequent."""

    KINDS: ClassVar[tuple[str, ...]] = (*ListedAxis.KINDS, "uniform", "loguniform", "normal", "integers")

    uniform: Annotated[tuple[float, float], AfterValidator(_rising)] | None = None
    """Ends of a uniform distribution."""
    loguniform: Annotated[tuple[Positive, Positive], AfterValidator(_rising)] | None = None
    """Ends, both > 0, of a log-uniform distribution."""
    normal: Normal | None = None
    integers: Annotated[tuple[int, int], AfterValidator(_rising)] | None = None
    """First and last of equally likely integers."""

    @property
    def ends(self) -> list[Any]:
        """Values checked before a campaign: all listed values, or both ends of a distribution."""
        return self.entries or [self.value_at(0.0), self.value_at(1.0)]

    def value_at(self, u: float) -> Any:
        """Value of this axis at the cumulative probability `u`, [0, 1]: the quantile."""
        if self.integers is not None:
            first, last = self.integers
            return min(last, first + floor(u * (last - first + 1)))
        if self.uniform is not None:
            low, high = self.uniform
            value = low + u * (high - low)
        elif self.loguniform is not None:
            low, high = self.loguniform
            value = low * (high / low) ** u
        elif (s := self.normal) is not None:
            from scipy.stats import truncnorm  # noqa: PLC0415 - most of a second, for who samples

            low, high = s.min, s.max
            value = s.mean + s.std * float(truncnorm.ppf(u, (low - s.mean) / s.std, (high - s.mean) / s.std))
        else:
            return self.entries[min(len(self.entries) - 1, floor(u * len(self.entries)))]
        return min(high, max(low, value))


class Sample(Section):
    """Points of a low-discrepancy sequence or a Latin hypercube, one dimension per axis."""

    method: Method
    count: Annotated[int, Field(ge=1, le=MOST_ROWS)]
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the draw."""
    axes: Annotated[dict[AxisName, SampledAxis], Field(min_length=1)]

    def draw(self) -> list[tuple[Any, ...]]:
        """Draw the axis values of every sample, one per axis in the order of the file.

        Sobol' points are scrambled (Owen 1995), so that no point is exactly 0 or 1 by construction; they are
        balanced if their number is a power of two.
        """
        from scipy.stats import qmc  # noqa: PLC0415 - most of a second, for who samples

        engines = {"sobol": qmc.Sobol, "latin_hypercube": qmc.LatinHypercube, "halton": qmc.Halton}
        engine = engines[self.method](len(self.axes), seed=np.random.default_rng(self.seed))
        if self.method == "sobol":
            # whole powers of two: SciPy warns about other numbers, whose balance is a little worse
            points = engine.random_base2(max(0, (self.count - 1).bit_length()))[: self.count]
        else:
            points = engine.random(self.count)
        return [
            tuple(axis.value_at(u) for axis, u in zip(self.axes.values(), point, strict=True))
            for point in points.tolist()
        ]


class Limit(Section):
    """Allowed range of a metric."""

    min: float | None = None
    max: float | None = None

    @model_validator(mode="after")
    def _an_end(self) -> Self:
        if self.min is None and self.max is None:
            raise ValueError("empty limit, allowed: min, max or both")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"min is above max, allowed: min <= max, given: {self.min}, {self.max}")
        return self

    def passed_by(self, value: float | None) -> float:
        """Excess of a value over the limit, relative to the limit; 0: within the limit, inf: not measured."""
        if value is None:
            return inf
        over = 0.0 if self.max is None else (value - self.max) / abs(self.max or 1.0)
        under = 0.0 if self.min is None else (self.min - value) / abs(self.min or 1.0)
        return max(over, under, 0.0)

    @property
    def words(self) -> str:
        """Allowed range as text, e.g. `>= 1 <= 2`."""
        ends = ((">=", self.min), ("<=", self.max))
        return " ".join(f"{sign} {end:g}" for sign, end in ends if end is not None)


class CampaignSettings(Section):
    """A campaign: every sample with every row of the list and every combination of the grid."""

    kind: Literal["campaign"]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]{0,100}$")] = ""
    """Name of the results folder; default: the file's name."""
    description: str = ""
    configuration: str = "virtual"
    """YAML file, relative to this one, or the name of a shipped configuration."""
    changes: dict[str, Any] = {}
    """Changes of the configuration for all runs, as in `hil.sim`."""
    duration_s: Annotated[float, Field(gt=0, le=LATEST_S)] | None = None
    """Time along the reference; default: to its end."""
    until: Literal["tracking", "parked"] = "tracking"
    """A run ends at the end of its reference, or after parking."""
    after_fault: Literal["end", "rest"] = "end"
    """A run that latches a fault ends at once, or when the platform is at rest; `travel_mm` needs `rest`."""
    sample: Sample | None = None
    list: Annotated[dict[AxisName, ListedAxis], Field(min_length=1)] | None = None
    """Axes that vary together: the first value of each, then the second of each ..."""
    grid: Annotated[dict[AxisName, ListedAxis], Field(min_length=1)] | None = None
    """Axes of which every combination runs."""
    limits: dict[Metric, Limit] = {}
    """Metric -> allowed range. `faulted` is at most 0 unless it is given here."""

    @model_validator(mode="after")
    def _rows(self) -> Self:
        if wrong := next(self._wrong(), ""):
            raise ValueError(wrong)
        return self

    def _wrong(self) -> Iterator[str]:
        if self.sample is None and self.list is None and self.grid is None:
            yield "no swept keys, allowed: a section sample, list or grid, or several of them"
        names: set[str] = {*METRICS, *OWN_COLUMNS}
        owners: dict[str, str] = {}
        for section, axes in self.sections:
            for name, axis in axes.items():
                if name in names:
                    yield f"{section}.{name}: already a column of the table, allowed: another name"
                names.add(name)
                for key in axis.targets:
                    if owners.setdefault(key, name) != name:
                        one = "allowed: one axis for each key"
                        yield f"{section}.{name}: {key} is also swept by {owners[key]}, {one}"
        lengths = {name: len(axis.entries) for name, axis in (self.list or {}).items()}
        if len(set(lengths.values())) > 1:
            given = ", ".join(f"{name} {length}" for name, length in lengths.items())
            yield f"list: allowed: axes with equally many values, given: {given}"
        samples, listed = self.sample.count if self.sample else 1, next(iter(lengths.values()), 1)
        rows = prod([samples, listed, *(len(axis.entries) for axis in (self.grid or {}).values())])
        if rows > MOST_ROWS:
            yield f"{rows} rows, allowed: up to {MOST_ROWS} of sample, list and grid"
        if "travel_mm" in self.limits and self.after_fault == "end":
            yield (
                "limits.travel_mm: not measured in runs that end at their fault, allowed: with "
                "after_fault: rest"
            )

    @property
    def axes(self) -> dict[str, ListedAxis]:
        """All swept axes by name, in the order of the table's columns."""
        return {name: axis for _, axes in self.sections for name, axis in axes.items()}

    @property
    def kept(self) -> dict[str, Limit]:
        """Limits that each row must keep, by metric; `faulted` is at most 0 by default."""
        return {"faulted": Limit(max=0.0)} | self.limits

    @property
    def sections(self) -> tuple[tuple[str, dict[str, ListedAxis]], ...]:
        """Axes of each section, by the section's place in the file."""
        sampled: dict[str, ListedAxis] = {} if self.sample is None else dict(self.sample.axes)
        return ("sample.axes", sampled), ("list", self.list or {}), ("grid", self.grid or {})


def schema() -> str:
    """JSON Schema of a campaign file, for editors; committed next to the shipped campaigns."""
    name = CampaignSettings.__name__
    found = described(name, CampaignSettings.model_json_schema(), "hexapod-hil campaign")
    return json.dumps(found, indent=1, ensure_ascii=False) + "\n"
