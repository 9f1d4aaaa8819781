"""File that `hil design` writes and the law `state_space` runs: one linear controller for six axes."""

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from drivers.section import Section
from hil.config.axis_model import AxisSpace
from hil.config.values import Positive

Row = list[float]
ControllerInput = Literal["error", "rate_error"]


class LinearController(Section):
    """x[k+1] = A x[k] + B y[k], u[k] = C x[k] + D y[k] of each axis; u adds to the demanded acceleration.

    y holds e = demanded - measured, m or rad, and also de if `inputs` lists it. With anti-windup the state
    also changes by `anti_windup` (n,) times the part of u that the limits removed.
    """

    kind: Literal["linear-controller"]
    method: Literal["hinf", "mu"]
    axes: AxisSpace
    rate_Hz: Positive
    inputs: Annotated[list[ControllerInput], Field(min_length=1, max_length=2)]
    A: list[Row]
    B: list[Row]
    C: Annotated[list[Row], Field(min_length=1, max_length=1)]
    D: Annotated[list[Row], Field(min_length=1, max_length=1)]
    anti_windup: Row
    """(n,) change of the state per m/s^2 or rad/s^2."""
    design: dict[str, Any]
    """Design data: weights, gamma, bounds of mu, margins, closed-loop poles."""

    @model_validator(mode="after")
    def _shapes(self) -> Self:
        n, m = len(self.A), len(self.inputs)
        expected = {"A": (n, n), "B": (n, m), "C": (1, n), "D": (1, m)}
        for name, (rows, columns) in expected.items():
            given = getattr(self, name)
            if len(given) != rows or any(len(row) != columns for row in given):
                raise ValueError(f"{name} is not {rows} x {columns}, with {n} rows of A and {m} inputs")
        if len(self.anti_windup) != n:
            raise ValueError(f"anti_windup has {len(self.anti_windup)} numbers, allowed: {n}, one per state")
        return self
