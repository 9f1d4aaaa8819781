"""Statements of a textbook chapter about control laws, checked against simulated tracking errors.

Section numbers are those of chapter 6, Control of Parallel Manipulators; docs/theory has its equations.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from hil.control import ControllerSettings
from hil.record.metrics import Share
from hil.study.compare.measure import Outcome

ID = "inverse_dynamics"
PEAK, STEADY = "peak_leg_error_mm", "steady_leg_error_mm"
POOR = 10.0
"""Factor between the error of a poor law and the error of a good one."""
BETTER = 3.0
"""Factor by which an additional term of a law must reduce the error."""
CLOSE = 1.5
"""Errors within this factor count as equal."""


class Claim(NamedTuple):
    """A statement of the chapter: `factor` times the error of `law` is below the error of `other`."""

    section: str
    text: str
    law: str
    factor: float
    other: str
    error: str = PEAK


CLAIMS = (
    Claim("6.1.1", "PD on leg lengths tracks poorly", ID, POOR, "pd"),
    Claim("6.1.1", "PD leaves a static error", ID, POOR, "pd", STEADY),
    Claim("6.1.1", "gravity compensation takes PD's static error away", "pd_gravity", POOR, "pd", STEADY),
    Claim("6.1.2", "with a good model feed-forward makes PD track", "feedforward_pd", BETTER, "pd"),
    Claim("6.1.3", "the law may be printed without (dJ/dt) twist", "printed", 1.0 / CLOSE, ID),
    Claim("6.1.3 B", "without H the linearisation is good enough", "partial_linearisation", 1.0 / POOR, ID),
    Claim("Lee 2003", "M, G and J of one pose are good enough", "constant", 1.0 / POOR, ID),
)
Found = dict[str, Any]


def judge(
    rows: Mapping[str, Outcome], settings: Mapping[str, ControllerSettings], shares: Mapping[str, Share]
) -> list[Found]:
    """Check the chapter's statements about the compared laws; each result has keys `holds` and `figures`.

    rows : measurements by law, on the configuration's own path; shares : of the model's terms in the force.
    """
    compared = [found for claim in CLAIMS if (found := _compared(claim, rows))]
    every = [*compared, *_linear(rows, settings), _H_small(shares["H"])]
    return sorted(every, key=lambda each: str(each["section"]))


def _found(section: str, text: str, figures: str, *, holds: bool) -> Found:
    return {"section": section, "claim": text, "holds": holds, "figures": figures}


def _compared(claim: Claim, rows: Mapping[str, Outcome]) -> Found | None:
    """Check a statement; None if its errors were not measured, or the reference law, ID, faulted."""
    pair = (claim.other, claim.law)
    if not all(law in rows and rows[law].figures for law in pair):
        return None
    errors, words = {}, []
    for law in pair:
        fault = rows[law].fault if claim.error == PEAK else None
        errors[law] = math.inf if fault else rows[law].figures.get(claim.error, math.nan)
        words.append(f"{law} {fault or f'{errors[law]:.3g} mm'}")
    measure_faulted = claim.error == PEAK and ID in pair and rows[ID].fault
    if measure_faulted or any(map(math.isnan, errors.values())):
        return None
    figures = f"{'peak' if claim.error == PEAK else 'at rest'}: {', '.join(words)}"
    holds = claim.factor * errors[claim.law] < errors[claim.other]
    return _found(claim.section, claim.text, figures, holds=holds)


def _linear(rows: Mapping[str, Outcome], settings: Mapping[str, ControllerSettings]) -> Iterator[Found]:
    s, measured = settings.get(ID), rows[ID].figures.get("bandwidth_Hz") if ID in rows else None
    wn, zeta = getattr(s, "wn_rad_s", None), getattr(s, "damping_ratio", math.nan)
    if not isinstance(wn, float) or measured is None or math.isnan(measured):
        return  # differs from leg to leg: no one bandwidth
    expected = second_order_bandwidth_Hz(wn, zeta)
    text = f"bandwidth {measured:.3g} Hz; wn {wn:g} rad/s, zeta {zeta:g} have {expected:.3g} Hz"
    holds = abs(measured / expected - 1.0) < 0.05
    yield _found("6.1.3", "inverse dynamics leaves E'' + K_D E' + K_P E = 0", text, holds=holds)


def second_order_bandwidth_Hz(wn: float, zeta: float) -> float:
    """-3 dB frequency, Hz, of wn^2 / (s^2 + 2 zeta wn s + wn^2), wn in rad/s, from |G|^2 = 1/2."""
    a = 1.0 - 2.0 * zeta**2
    return wn / (2.0 * math.pi) * math.sqrt(a + math.sqrt(a**2 + 1.0))


def _H_small(h: Share) -> Found:
    text = f"at most {100 * h.share:.2g} % of the leg force, {h.force_N:.3g} N"
    return _found("6.1.3 B", "H takes less than 1 % of the force", text, holds=h.share < 0.01)
