"""The campaign file: which configuration, which keys are swept and how, what a run must keep."""

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from drivers.section import Section
from hil.app.sim.commands import LATEST_S

Pair = tuple[float, float]
AxisName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,49}$")]
Method = Literal["sobol", "latin_hypercube", "halton"]


class Normal(Section):
    """A normal distribution cut off at both ends."""

    mean: float
    std: Annotated[float, Field(gt=0)]
    min: float
    max: float

    @model_validator(mode="after")
    def _some_width(self) -> Self:
        if self.min >= self.max:
            raise ValueError(f"min is not below max, allowed: min < max, given: {self.min:g}, {self.max:g}")
        return self


class ListedAxis(Section):
    """Values of one axis: of a key of the configuration, or sets of changes by name, or faults by name."""

    key: str | list[str] | None = None
    """Where the value goes: `plant.drives.encoder_resolution_m`, `plant.faults[0].mass_kg`, `seed`; several
    keys take the same value."""
    values: Annotated[list[Any], Field(min_length=1)] | None = None
    """Values of `key`."""
    options: Annotated[dict[str, dict[str, Any]], Field(min_length=1)] | None = None
    """Name -> changes of the configuration: laws, designs, plants, paths."""
    faults: Annotated[dict[str, list[str]], Field(min_length=1)] | None = None
    """Name -> faults that are added to `plant.faults`, in the words of `hil sim --fault`; `[]`: none."""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        _exactly_one(self, ("values", "options", "faults"))
        _keyed(self.key, self.values is not None)
        return self


class SampledAxis(ListedAxis):
    """An axis that is drawn: from a distribution of a key, or each of the listed ones equally often."""

    uniform: Pair | None = None
    """Ends of a uniform distribution."""
    loguniform: Pair | None = None
    """Ends, both > 0, between which the logarithm is uniform."""
    normal: Normal | None = None
    integers: tuple[int, int] | None = None
    """First and last of equally likely whole numbers."""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        drawn = ("uniform", "loguniform", "normal", "integers")
        _exactly_one(self, ("values", "options", "faults", *drawn))
        _keyed(self.key, self.options is None and self.faults is None)
        for name in ("uniform", "loguniform", "integers"):
            ends = getattr(self, name)
            if ends is not None and ends[0] >= ends[1]:
                raise ValueError(
                    f"{name}: no range, allowed: [low, high] with low < high, given: {list(ends)}"
                )
        if self.loguniform is not None and self.loguniform[0] <= 0.0:
            raise ValueError(f"loguniform: allowed: two numbers > 0, given: {list(self.loguniform)}")
        return self


class Sample(Section):
    """Points of a low-discrepancy sequence or a Latin hypercube, one dimension an axis."""

    method: Method
    count: Annotated[int, Field(ge=1, le=10_000_000)]
    seed: Annotated[int, Field(ge=0)] = 0
    """Of the draw."""
    axes: Annotated[dict[AxisName, SampledAxis], Field(min_length=1)]


class Limit(Section):
    """What a metric may be."""

    min: float | None = None
    max: float | None = None

    @model_validator(mode="after")
    def _an_end(self) -> Self:
        if self.min is None and self.max is None:
            raise ValueError("no limit, allowed: min, max or both")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"min is above max, allowed: min <= max, given: {self.min}, {self.max}")
        return self


class CampaignSettings(Section):
    """A campaign: every sample with every row of the list and every combination of the grid."""

    kind: Literal["campaign"]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]{0,100}$")] = ""
    """Of the folder of results; default is the file's name."""
    description: str = ""
    configuration: str = "virtual"
    """A YAML file, relative to this one, or the name of a shipped configuration."""
    changes: dict[str, Any] = {}
    """Sections of the configuration that are changed in all runs, as `hil.sim` changes them."""
    duration_s: Annotated[float, Field(gt=0, le=LATEST_S)] | None = None
    """Along the reference; default: to its end."""
    until: Literal["tracking", "parked"] = "tracking"
    """A run ends with its reference, or parks first."""
    after_fault: Literal["end", "rest"] = "end"
    """A run that latches a fault ends at once, or when the platform is at rest: `travel_mm` is known then."""
    sample: Sample | None = None
    list: Annotated[dict[AxisName, ListedAxis], Field(min_length=1)] | None = None
    """Axes that go together: the first value of each, the second of each ..."""
    grid: Annotated[dict[AxisName, ListedAxis], Field(min_length=1)] | None = None
    """Axes of which every combination runs."""
    limits: dict[str, Limit] = {}
    """Metric -> what it may be. `faulted` is at most 0 unless it is given here."""

    @model_validator(mode="after")
    def _some_axes(self) -> Self:
        if self.sample is None and self.list is None and self.grid is None:
            raise ValueError("nothing is swept, allowed: a section sample, list or grid, or several of them")
        lengths = {name: len(entries(axis)) for name, axis in (self.list or {}).items()}
        if len(set(lengths.values())) > 1:
            given = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise ValueError(f"list: allowed: axes with equally many values, given: {given}")
        return self


def entries(axis: ListedAxis) -> list[Any]:
    """Return the values of a listed axis, of options and faults their names; of a distribution none."""
    if axis.values is not None:
        return axis.values
    return list(axis.options or axis.faults or {})


def _exactly_one(axis: ListedAxis, names: tuple[str, ...]) -> None:
    given = [name for name in names if getattr(axis, name) is not None]
    if len(given) != 1:
        raise ValueError(f"allowed: exactly one of {', '.join(names)}, given: {', '.join(given) or 'none'}")


def _keyed(key: str | list[str] | None, needed: bool) -> None:
    if needed and not key:
        raise ValueError(
            "key is missing, allowed: a key of the configuration, as plant.model.coulomb_friction_N"
        )
    if not needed and key:
        raise ValueError("key has no meaning beside options or faults, which say themselves what they change")
