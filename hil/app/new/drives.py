"""The drives of `hil new`: our own protocol, or a family that can be bought. One row each.

What a robot's owner knows of such a drive is the leg length a turn of the shaft whose position it reports;
all else follows from that, the drive's force and the family's own fields.
"""

from __future__ import annotations

from typing import NamedTuple

from drivers.mit.fields import TURN, VARIANTS, Ranges
from hil.app.new.robot import Answers

LEGS_PROTOCOL = "legs"
LONGEST_TURN = 10.0
"""Times the stroke: a pinion that large is none, the number was in mm."""
ROOM = 0.99
"""Share of a field's range that is used: its ends are no readings, and its top torques are not sent."""


class Family(NamedTuple):
    """What its configuration differs in."""

    protocol: str
    layout: str
    """Frame layout that it has; that of `legs` is free, and this its default."""
    silence: str = ""
    """What its drives do that hear nothing, where they do not brake."""
    torque_bits: int = 0
    """Bits of a torque that is sent over a range; 0: it is sent as it is."""


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
"""Answer -> its row; of MIT framing the variants."""


def family(a: Answers) -> Family:
    """Family of the answers; before it has been asked, `legs`."""
    return FAMILIES[a.get("drives") or LEGS_PROTOCOL]


def bought(a: Answers) -> bool:
    """Whether the drives speak of a motor."""
    return family(a).protocol != LEGS_PROTOCOL


def counts_itself(a: Answers) -> bool:
    """Whether the frames carry a length in steps of the family's own."""
    return family(a).protocol in ("cia402", "mit")


def models(a: Answers) -> tuple[str, ...]:
    """Models whose ranges are known; none where the family has no ranges."""
    variant = VARIANTS.get(a.get("drives") or "")
    return () if variant is None else tuple(variant.models)


def has_models(a: Answers) -> bool:
    """Whether the ranges depend on the model."""
    return len(models(a)) > 1


def model(a: Answers) -> str:
    """Model as its family writes it: case does not count. As it was typed where it is unknown."""
    typed = str(a["model"]) if has_models(a) else models(a)[0]
    return next((name for name in models(a) if name.casefold() == typed.casefold()), typed)


def _ranges(a: Answers) -> Ranges:
    return VARIANTS[a["drives"]].models[model(a)]


def model_trouble(a: Answers) -> str | None:
    """Why a model is unknown; None where it is known."""
    known = models(a)
    return None if model(a) in known else f"allowed with {a['drives']}: {', '.join(known)}, given: {model(a)}"


def travel_trouble(a: Answers, finest_m: float) -> str | None:
    """Why the leg length a turn suits neither stroke nor the model's fields; None where it does.

    finest_m: below it the steps of the torque are too coarse, m.
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
        allowed = f"{model(a)} suits at no lead, {least:.4g} to {most:.4g} m a turn: take another model"
    return (
        f"{allowed}. Its position of +-{r.position:g} rad has to carry {stroke:g} m of stroke, its torque of "
        f"{r.torque:g} N m {a['drive_force_N']:g} N; one code of torque is {force_step_N(a, travel):.2g} N "
        "at the leg, and has to leave it within 2 % of the stroke"
    )


def force_step_N(a: Answers, travel_m: float) -> float:
    """Force at the leg that one code of the model's torque is, N."""
    return float(2.0 * _ranges(a).torque / (2 ** family(a).torque_bits - 1) * TURN / travel_m)


def travels_m(a: Answers) -> tuple[float, float]:
    """Least and largest leg length a turn, m, that the ranges carry."""
    r = _ranges(a)
    return a["stroke_m"] * TURN / (2.0 * ROOM * r.position), ROOM * TURN * r.torque / a["drive_force_N"]
