"""The drives of `hil new`: our own protocol, or a family that can be bought. One row each.

What a robot's owner knows of such a drive is the leg length a turn of the shaft whose position it reports;
all else follows from that, the drive's force and the family's own fields.
"""

from __future__ import annotations

from math import ceil
from typing import Any, NamedTuple

from drivers.mit.fields import TURN, VARIANTS, Ranges

Answers = dict[str, Any]
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
    silence: str = "brake"
    """What its drives do that hear nothing."""
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
    """Return the family of the answers; before it has been asked, `legs`."""
    return FAMILIES[a.get("drives") or LEGS_PROTOCOL]


def bought(a: Answers) -> bool:
    """Say whether the drives speak of a motor."""
    return family(a).protocol != LEGS_PROTOCOL


def models(a: Answers) -> tuple[str, ...]:
    """Return the models whose ranges are known; none where the family has no ranges."""
    variant = VARIANTS.get(a.get("drives") or "")
    return () if variant is None else tuple(variant.models)


def has_models(a: Answers) -> bool:
    """Say whether the ranges depend on the model."""
    return len(models(a)) > 1


def _ranges(a: Answers) -> Ranges:
    return VARIANTS[a["drives"]].models[_model(a)]


def _model(a: Answers) -> str:
    """Return the model as its family writes it: case does not count. As it was typed where there is none."""
    if not has_models(a):
        return models(a)[0]
    typed = str(a["model"])
    return next((name for name in models(a) if name.casefold() == typed.casefold()), typed)


def model_trouble(a: Answers) -> str | None:
    """Return why a model is none, or too weak for the robot at any lead; None where it is neither."""
    if _model(a) not in models(a):
        return f"allowed with {a['drives']}: {', '.join(models(a))}, given: {_model(a)}"
    least, most = travels_m(a)
    if least <= most:
        return None
    r = _ranges(a)
    return (
        f"{_model(a)} is too weak at any lead: it reports {2 * r.position / TURN:.3g} turns, so "
        f"{a['stroke_m']:g} m of stroke need at least {least:.4g} m a turn, and its {r.torque:g} N m are "
        f"{a['drive_force_N']:g} N up to {most:.4g} m a turn; state a smaller --drive-force or --stroke, "
        "or take another model"
    )


def travel_trouble(a: Answers, finest_m: float = 0.0) -> str | None:
    """Return why the leg length a turn suits neither stroke nor the model's fields; None where it does.

    finest_m: below it the steps of the torque are too coarse, m.
    """
    if not models(a):
        if a["travel_m"] <= LONGEST_TURN * a["stroke_m"]:
            return None
        return (
            f"allowed: up to {LONGEST_TURN * a['stroke_m']:g} m a turn, {LONGEST_TURN:g} times the stroke of "
            f"{a['stroke_m']:g} m, given: {a['travel_m']:g}; it is in m, so a lead of 10 mm is 0.01"
        )
    carried, most = travels_m(a)
    least = max(carried, finest_m)
    if least <= a["travel_m"] <= most:
        return None
    r, coarse = _ranges(a), ""
    if finest_m > carried:
        coarse = (
            f"; one code of torque is {force_step_N(a, a['travel_m']):.2g} N at the leg, and has to leave it "
            "within 2 % of the stroke"
        )
    if carried <= most < least:
        return f"{_model(a)} is too strong for a robot this light at any lead{coarse}; take a weaker model"
    return model_trouble(a) or (
        f"allowed with {_model(a)}: {least:.4g} to {most:.4g} m a turn, given: {a['travel_m']:g}. Its "
        f"position of +-{r.position:g} rad has to carry {a['stroke_m']:g} m of stroke, its torque of "
        f"{r.torque:g} N m {a['drive_force_N']:g} N{coarse}"
    )


def force_step_N(a: Answers, travel_m: float) -> float:
    """Return what one code of the model's torque is at the leg, N."""
    r, own = _ranges(a), family(a)
    return float(2.0 * r.torque / (2**own.torque_bits - 1) * TURN / travel_m)


def travels_m(a: Answers) -> tuple[float, float]:
    """Return the least and the largest leg length a turn, m, that the ranges carry."""
    r = _ranges(a)
    return a["stroke_m"] * TURN / (2.0 * ROOM * r.position), ROOM * TURN * r.torque / a["drive_force_N"]


def drives_section(a: Answers, rate_Hz: float) -> dict[str, Any]:
    """Return section `drives`."""
    own = family(a)
    section: dict[str, Any] = {"protocol": own.protocol}
    if bought(a):
        section |= {"options": options} if (options := _options(a)) else {}
    section["node_ids"] = [1, 2, 3, 4, 5, 6]
    if bought(a):
        counts = {"counts_per_turn": _counts(a)} if own.protocol == "cia402" else {}
        middle = a["length_min_m"] + a["stroke_m"] / 2
        section["transmission"] = {"lead_m": a["travel_m"], **counts, "offset_m": middle}
    section["watchdog_ms"] = max(10.0, float(ceil(5e3 / rate_Hz)))
    section["force_limit_N"] = a["drive_force_N"]
    return section


def _options(a: Answers) -> dict[str, Any]:
    torque = float(f"{1.005 * a['drive_force_N'] * a['travel_m'] / TURN:.3g}")  # rounding leaves it enough
    match family(a).protocol:
        case "cia402":
            return {"rated_torque_Nm": torque, "velocity": "pdo"}
        case "moteus":
            return {"timeout_mode": "zero_velocity", "torque_N_m": torque}
        case "mit":
            return {"variant": a["drives"], "model": _model(a)}
    return {}


def _counts(a: Answers) -> int:
    """Return the counts a turn that the encoder's resolution is."""
    travel, resolution = float(a["travel_m"]), float(a["encoder_resolution_m"])
    return max(1, round(travel / resolution))


def counts_itself(a: Answers) -> bool:
    """Say whether the frames carry a length in steps of the family's own."""
    return family(a).protocol in ("cia402", "mit")
