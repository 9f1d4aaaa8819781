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
        return math.inf if row.fault else float(row.figures.get("peak_leg_error_mm", math.inf))

    def peaks(self, *laws: str) -> str:
        """Return the peak errors of laws in words."""
        found = (f"{law} {self.rows[law].fault or f'{self.error(law):.3g} mm'}" for law in laws)
        return f"peak: {', '.join(found)}"


Found = tuple[bool, str] | None
"""Whether a claim holds, and the figures that say so; None where what it takes was not measured."""


class Claim(NamedTuple):
    """A sentence of the chapter and how it is judged."""

    section: str
    text: str
    needs: tuple[str, ...]
    """Laws that have to be among the compared ones."""
    judge: Callable[[Evidence], Found]
    yardstick: str | None = None
    """The law whose error is the measure: where it faulted, there is none."""


def _good_enough(*laws: str) -> Callable[[Evidence], Found]:
    """Return the judge of whether the peak error of the first law is of inverse dynamics' kind."""
    return lambda e: (e.error(laws[0]) < POOR * e.error(ID), e.peaks(*laws, ID))


def _less_at_rest(law: str) -> Callable[[Evidence], Found]:
    """Return the judge of whether a law has little of the error that PD has at rest."""

    def judge(e: Evidence) -> Found:
        left, whole = (e.rows[name].figures.get("steady_leg_error_mm", math.nan) for name in (law, "pd"))
        if math.isnan(left + whole):
            return None
        return whole > POOR * left, f"at rest: pd {whole:.3g} mm, {law} {left:.3g} mm"

    return judge


def _linear(e: Evidence) -> Found:
    s, measured = e.settings.get(ID), e.rows[ID].figures.get("bandwidth_Hz", math.nan)
    wn, zeta = getattr(s, "wn_rad_s", None), getattr(s, "damping_ratio", math.nan)
    if not isinstance(wn, float) or math.isnan(measured):
        return None  # differs from leg to leg: no one bandwidth
    expected = second_order_bandwidth_Hz(wn, zeta)
    text = f"bandwidth {measured:.3g} Hz; wn {wn:g} rad/s, zeta {zeta:g} have {expected:.3g} Hz"
    return abs(measured / expected - 1.0) < 0.05, text


def second_order_bandwidth_Hz(wn: float, zeta: float) -> float:
    """Return the -3 dB frequency of wn^2 / (s^2 + 2 zeta wn s + wn^2), wn in rad/s, from |G|^2 = 1/2."""
    a = 1.0 - 2.0 * zeta**2
    return wn / (2.0 * math.pi) * math.sqrt(a + math.sqrt(a**2 + 1.0))


def _H_small(e: Evidence) -> Found:
    h = e.shares["H"]
    return h.share < 0.01, f"at most {100 * h.share:.2g} % of the leg force, {h.force_N:.3g} N"


def _J_dot_small(e: Evidence) -> Found:
    j = e.shares["J_dot"]
    text = f"{100 * j.share:.3g} % of the leg force, {j.force_N:.4g} N; {e.peaks('printed', ID)}"
    return e.error("printed") < CLOSE * e.error(ID), text


CLAIMS = (
    Claim(
        "6.1.1",
        "PD on leg lengths tracks poorly",
        ("pd", ID),
        lambda e: (e.error("pd") > POOR * e.error(ID), e.peaks("pd", ID)),
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
        lambda e: (e.error("feedforward_pd") * BETTER < e.error("pd"), e.peaks("pd", "feedforward_pd")),
    ),
    Claim("6.1.3", "inverse dynamics leaves E'' + K_D E' + K_P E = 0", (ID,), _linear),
    Claim("6.1.3", "the law may be printed without (dJ/dt) twist", ("printed", ID), _J_dot_small, ID),
    Claim("6.1.3 B", "H takes less than 1 % of the force", (), _H_small),
    Claim(
        "6.1.3 B",
        "without H the linearisation is good enough",
        ("partial_linearisation", ID),
        _good_enough("partial_linearisation"),
        ID,
    ),
    Claim(
        "Lee 2003",
        "M, G and J of one pose are good enough",
        ("constant", "constant_MG", ID),
        _good_enough("constant", "constant_MG"),
        ID,
    ),
)


def judge(evidence: Evidence) -> list[dict[str, Any]]:
    """Return the claims whose laws were compared, each with `holds` and `figures`."""
    rows, found = evidence.rows, []
    for claim in CLAIMS:
        measured = all(law in rows and rows[law].figures for law in claim.needs)
        if not measured or (claim.yardstick and rows[claim.yardstick].fault):
            continue
        if finding := claim.judge(evidence):
            holds, figures = finding
            found.append({"section": claim.section, "claim": claim.text, "holds": holds, "figures": figures})
    return found
