"""Drive families that `hil new` offers: our own protocol `legs`, or families on the market, one row each.

The robot's owner knows the leg length per turn of the shaft whose position the drive reports. All else
follows from this travel, the drive's force and the fields of the family.
"""

from __future__ import annotations

from typing import NamedTuple

from drivers.mit.fields import TURN, VARIANTS, Ranges
from hil.app.new.robot import Answers

LEGS_PROTOCOL = "legs"
LONGEST_TURN = 10.0
"""Largest plausible travel a turn, in strokes: beyond it the number was in mm."""
ROOM = 0.99
"""Used share of a field's range: its ends are not valid readings, and its largest torques are not sent."""


class Family(NamedTuple):
    """Settings of a drive family in the new configuration."""

    protocol: str
    layout: str
    """Its frame layout; for `legs` only the default."""
    silence: str = ""
    """Reaction of its drives to silence, if they do not brake."""
    torque_bits: int = 0
    """Bits of a torque that is scaled to a range; 0: it is not scaled."""


FAMILIES: dict[str, Family] = {
    LEGS_PROTOCOL: Family("legs", "fd"),
    "cia402": Family("cia402", "classic"),
    "moteus": Family("moteus", "fd", silence="damp"),
    "odrive": Family("odrive", "classic"),
    "cubemars": Family("mit", "classic", torque_bits=12),
    "damiao": Family("mit", "classic", torque_bits=12),
    "mini_cheetah": Family("mit", "classic", torque_bits=12),
    "robstride": Family("mit", "classic", torque_bits=16),
}
"""Answer -> its row; for MIT framing the variants."""


def family(a: Answers) -> Family:
    """Drive family of the answers; `legs` until the question is answered."""
    return FAMILIES[a.get("drives") or LEGS_PROTOCOL]


def bought(a: Answers) -> bool:
    """True if the drives report motor positions instead of leg lengths."""
    return family(a).protocol != LEGS_PROTOCOL


def counts_itself(a: Answers) -> bool:
    """True if the family's frames determine the resolution of a length."""
    return family(a).protocol in ("cia402", "mit")


def models(a: Answers) -> tuple[str, ...]:
    """Drive models with known field ranges; empty for a family without ranges."""
    variant = VARIANTS.get(a.get("drives") or "")
    return () if variant is None else tuple(variant.models)


def has_models(a: Answers) -> bool:
    """True if the drives' field ranges depend on the model."""
    return len(models(a)) > 1


def model(a: Answers) -> str:
    """Drive model in the family's spelling, found without regard to case; an unknown model as typed."""
    typed = str(a["model"]) if has_models(a) else models(a)[0]
    return next((name for name in models(a) if name.casefold() == typed.casefold()), typed)


def _ranges(a: Answers) -> Ranges:
    return VARIANTS[a["drives"]].models[model(a)]


def model_trouble(a: Answers) -> str | None:
    """Reason why a drive model is unknown; None for a known model."""
    known = models(a)
    return None if model(a) in known else f"allowed with {a['drives']}: {', '.join(known)}, given: {model(a)}"


def travel_trouble(a: Answers, finest_m: float) -> str | None:
    """Reason why the leg travel per turn does not suit stroke or the model's fields; None if it suits.

    finest_m: travel per turn below which the torque resolution is too coarse, m.
    """
    travel, stroke = a["travel_m"], a["stroke_m"]
    if not models(a):
        most = LONGEST_TURN * stroke
        long = f"allowed: up to {most:g} m a turn, {LONGEST_TURN:g} times the stroke of {stroke:g} m, given: "
        return None if travel <= most else f"{long}{travel:g}; it is in m, so a lead of 10 mm is 0.01"
    (carried, most), r = travels_m(a), _ranges(a)
    least = max(carried, finest_m)
    if least <= travel <= most:
        return None
    allowed = f"allowed with {model(a)}: {least:.4g} to {most:.4g} m a turn, given: {travel:g}"
    if least > most:
        allowed = f"{model(a)} suits no lead, {least:.4g} to {most:.4g} m a turn: choose another model"
    return (
        f"{allowed}. Its position of +-{r.position:g} rad has to carry {stroke:g} m of stroke, its torque of "
        f"{r.torque:g} N m {a['drive_force_N']:g} N; one code of torque is {force_step_N(a, travel):.2g} N "
        "at the leg, and its error has to stay within 2 % of the stroke"
    )


def force_step_N(a: Answers, travel_m: float) -> float:
    """Force at the leg for one code of the drive's torque field, N; travel_m: leg travel per turn, m."""
    return float(2.0 * _ranges(a).torque / (2 ** family(a).torque_bits - 1) * TURN / travel_m)


def travels_m(a: Answers) -> tuple[float, float]:
    """Least and largest leg travel per turn, m, that the ranges of the drive's fields allow."""
    r = _ranges(a)
    return a["stroke_m"] * TURN / (2.0 * ROOM * r.position), ROOM * TURN * r.torque / a["drive_force_N"]
