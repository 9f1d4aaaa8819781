"""What is known of the stability of a law."""

from typing import Any, Literal, NamedTuple

Status = Literal["proven", "conditional", "not proven", "unstable"]


class Assessment(NamedTuple):
    """The answer for one law and configuration."""

    status: Status
    """`conditional`: proven where all of `conditions` hold, which are not checked. `unstable`: refuted."""
    claim: str
    """What is proven; what is not, where nothing is."""
    conditions: list[str]
    lines: list[str]
    """Figures with their units, for people."""
    figures: dict[str, Any]
    """The same as plain values."""

    @property
    def line(self) -> str:
        """Status and claim in one line."""
        return f"{self.status}: {self.claim}"


def unless(conditions: list[str]) -> Status:
    """Return proven, or conditional where there are conditions."""
    return "conditional" if conditions else "proven"
