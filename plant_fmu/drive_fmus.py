"""Configuration section `plant.drives.fmu`: drives that come as CAN FMUs."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from drivers.section import Section

Unit = Literal["N", "N.m", "m", "m/s"]


class DriveFmus(Section):
    """CAN FMUs (FMI-LS-BUS) that are the drives: frames on the bus, and ordinary variables to the plant."""

    path: Annotated[list[str], Field(min_length=1)]
    """One .fmu file with all six drives, or six files in leg order; relative to the configuration file."""
    length: list[str]
    """Input variables, unit m. One file: six names, or one array of six. Six files: one name."""
    rate: list[str] = []
    """Input variables, unit m/s, likewise; empty if the FMUs have none."""
    force: list[str]
    """Output variables, unit N, > 0 extends, likewise."""
    brake: list[str]
    """Output variables, Float64 or Boolean, 1 or true is engaged, likewise. Empty: the drives have no brakes,
    and the plant's brakes stay open."""
    parameters: dict[str, float | int | bool | str | list[float]] = {}
    """Parameters to set. Of six files each takes its element of a list of six."""
    assume_unit: dict[str, Unit] = {}
    """Units of variables that declare none, by name, or by force, length, rate."""
    step_us: Annotated[float, Field(gt=0)] = 250.0
    """Longest communication step, rounded to whole steps of the plant. Frames and countdowns are met at
    their own times."""

    @model_validator(mode="after")
    def _one_or_six(self) -> Self:
        if len(self.path) not in (1, 6):
            raise ValueError(f"path: allowed: one file or six, given: {len(self.path)}")
        allowed = (1, 6) if len(self.path) == 1 else (1,)
        for key in ("length", "rate", "force", "brake"):
            names = getattr(self, key)
            if len(names) not in allowed and (names or key in {"length", "force"}):
                raise ValueError(
                    f"{key}: allowed with {len(self.path)} file(s): {' or '.join(map(str, allowed))} names, "
                    f"given: {len(names)}"
                )
        return self
