"""What the control chapter says of its laws, and whether it holds here.

Sections are those of chapter 6, Control of Parallel Manipulators; docs/theory has its equations.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from hil.control import ControllerSettings
from hil.record.metrics import Share
from hil.study.compare.measure import Outcome

ID = "inverse_dynamics"
POOR = 10.0
"""An error that is so many times another's is of another kind."""
BETTER = 3.0
"""So much less error is worth a term more in the law."""
CLOSE = 1.5
"""Errors within this factor are the same for an engineer."""


class Evidence(NamedTuple):
    """What claims are judged by."""

    rows: Mapping[str, Outcome]
    """By law, on the configuration's own path."""
    settings: Mapping[str, ControllerSettings]
    shares: Mapping[str, Share]

    def error(self, law: str) -> float:
        """Return the peak leg error in mm; inf for a law that faulted."""
        row = self.rows[law]
        return math.inf if row.fault else float(row.figures["peak_leg_error_mm"])

    def at_rest(self, law: str) -> float:
        """Return the leg error at rest in mm; nan where it was not measured."""
        return float(self.rows[law].figures.get("steady_leg_error_mm", math.nan))

    def says(self, law: str) -> str:
        """Return the peak error in words."""
        row = self.rows[law]
        return f"{law} {row.fault}" if row.fault else f"{law} {self.error(law):.3g} mm"


class Finding(NamedTuple):
    """Whether a claim holds, and the figures that say so."""

    holds: bool
    figures: str


Judge = Callable[[Evidence], Finding | None]
"""None where what it takes was not measured."""


class Claim(NamedTuple):
    """A sentence of the chapter and how it is judged."""

    section: str
    text: str
    needs: tuple[str, ...]
    """Laws that have to be among the compared ones."""
    judge: Judge
    yardstick: str | None = None
    """The law whose error is the measure: where it faulted, there is none."""


def _peaks(holds: Callable[[Callable[[str], float]], bool], *laws: str) -> Judge:
    """Return the judge of a relation between the peak errors of laws; these errors are its figures."""
    return lambda e: Finding(holds(e.error), f"peak: {', '.join(map(e.says, laws))}")


def _less_at_rest(law: str) -> Judge:
    """Return the judge of whether a law has little of the error that PD has at rest."""

    def judge(e: Evidence) -> Finding | None:
        left, whole = e.at_rest(law), e.at_rest("pd")
        if math.isnan(left) or math.isnan(whole):
            return None
        return Finding(whole > POOR * left, f"at rest: pd {whole:.3g} mm, {law} {left:.3g} mm")

    return judge


def _linear(e: Evidence) -> Finding | None:
    s = e.settings.get(ID)
    wn, zeta = getattr(s, "wn_rad_s", math.nan), getattr(s, "damping_ratio", math.nan)
    measured = float(e.rows[ID].figures.get("bandwidth_Hz", math.nan))
    if not isinstance(wn, float) or math.isnan(wn + measured):
        return None  # differs from leg to leg: no one bandwidth
    expected = second_order_bandwidth_Hz(wn, zeta)
    text = f"bandwidth {measured:.3g} Hz; wn {wn:g} rad/s, zeta {zeta:g} have {expected:.3g} Hz"
    return Finding(abs(measured / expected - 1.0) < 0.05, text)


def second_order_bandwidth_Hz(wn: float, zeta: float) -> float:
    """Return the -3 dB frequency of wn^2 / (s^2 + 2 zeta wn s + wn^2), wn in rad/s, from |G|^2 = 1/2."""
    a = 1.0 - 2.0 * zeta**2
    return wn / (2.0 * math.pi) * math.sqrt(a + math.sqrt(a**2 + 1.0))


def _H_small(e: Evidence) -> Finding:
    h = e.shares["H"]
    return Finding(h.share < 0.01, f"at most {100 * h.share:.2g} % of the leg force, {h.force_N:.3g} N")


def _J_dot_small(e: Evidence) -> Finding:
    j = e.shares["J_dot"]
    text = (
        f"{100 * j.share:.3g} % of the leg force, {j.force_N:.4g} N; peak: {e.says('printed')}, {e.says(ID)}"
    )
    return Finding(e.error("printed") < CLOSE * e.error(ID), text)


CLAIMS: tuple[Claim, ...] = (
    Claim(
        "6.1.1",
        "PD on leg lengths tracks poorly",
        ("pd", ID),
        _peaks(lambda error: error("pd") > POOR * error(ID), "pd", ID),
        ID,
    ),
    Claim("6.1.1", "PD leaves a static error", ("pd", ID), _less_at_rest(ID)),
    Claim(
        "6.1.1",
        "gravity compensation takes PD's static error away",
        ("pd", "pd_gravity"),
        _less_at_rest("pd_gravity"),
    ),
    Claim(
        "6.1.2",
        "with a good model feed-forward makes PD track",
        ("pd", "feedforward_pd"),
        _peaks(lambda error: error("feedforward_pd") * BETTER < error("pd"), "pd", "feedforward_pd"),
    ),
    Claim("6.1.3", "inverse dynamics leaves E'' + K_D E' + K_P E = 0", (ID,), _linear),
    Claim("6.1.3", "the law may be printed without (dJ/dt) twist", ("printed", ID), _J_dot_small, ID),
    Claim("6.1.3 B", "H takes less than 1 % of the force", (), _H_small),
    Claim(
        "6.1.3 B",
        "without H the linearisation is good enough",
        ("partial_linearisation", ID),
        _peaks(lambda error: error("partial_linearisation") < POOR * error(ID), "partial_linearisation", ID),
        ID,
    ),
    Claim(
        "Lee 2003",
        "M, G and J of one pose are good enough",
        ("constant", "constant_MG", ID),
        _peaks(lambda error: error("constant") < POOR * error(ID), "constant", "constant_MG", ID),
        ID,
    ),
)


def judge(evidence: Evidence) -> list[dict[str, Any]]:
    """Return the claims whose laws were compared, each with `holds` and `figures`."""
    found = []
    for claim in CLAIMS:
        measured = all(law in evidence.rows and evidence.rows[law].figures for law in claim.needs)
        if measured and not (claim.yardstick and evidence.rows[claim.yardstick].fault):
            finding = claim.judge(evidence)
            if finding is not None:
                found.append({"section": claim.section, "claim": claim.text, **finding._asdict()})
    return found
