"""Questions of `hil new`, one table row each, with unit, range, default and plausibility check."""

from __future__ import annotations

from collections.abc import Callable
from math import hypot, isfinite, pi
from typing import Any, NamedTuple

import click

from drivers.errors import HilError
from hil.app.new import derive, drives
from hil.app.new.robot import (
    ESTIMATE,
    HOLD_SHARE,
    LOWER_SHARE,
    MOUNTINGS,
    WORST_CONDITION,
    Answers,
    STRONGEST_m_s2,
    condition_at_home,
    joints_apart_m,
    robot_at_home,
)
from hil.app.new.template import DIGITS
from hil.mathematics.rounding import rounded


class Figure(click.FloatRange):
    """Type of a numeric answer: a finite number in a unit, rounded to `DIGITS` digits."""

    def __init__(self, unit: str, low: float = 0.0, high: float | None = None) -> None:
        super().__init__(low, high)
        self.unit = unit
        self.name = f"number in {unit} without the unit, with a decimal point"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Convert an answer to a rounded number; a number that is not finite is refused."""
        number = float(super().convert(value, param, ctx))
        return (
            rounded(number, DIGITS) if isfinite(number) else self.fail(f"{value} is not finite", param, ctx)
        )


class MovingMass(Figure):
    """Type of a mass along the leg: kg, or a rotor's kg m^2@m a turn, as 5e-5@0.005: I (2 pi / lead)^2."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Convert either form to kg. Raises click.BadParameter."""
        inertia, at, lead = str(value).partition("@")
        if at:
            try:
                value = float(inertia) * (2.0 * pi / float(lead)) ** 2
            except (ValueError, ZeroDivisionError, OverflowError):
                self.fail(f"{value}, allowed: kg, or kg m^2@m a turn, as 5e-5@0.005", param, ctx)
        return super().convert(value, param, ctx)


def _three(
    text: str, words: tuple[str, ...], allowed: str, within: Callable[[list[float]], bool]
) -> str | list[float]:
    """A word of `words`, or three finite numbers with commas. Raises click.BadParameter."""
    if text in words:
        return text
    try:
        found = [rounded(float(word), DIGITS) for word in text.split(",")]
    except ValueError:
        found = []
    if len(found) != 3 or not all(map(isfinite, found)) or not within(found):
        raise click.BadParameter(f"allowed: {allowed}, given: {text}")
    return found


def moments(text: str) -> str | list[float]:
    """Parse three moments of inertia > 0, kg m^2, with commas, or `estimate`. Raises click.BadParameter."""
    allowed = f"three numbers above 0 with commas, or {ESTIMATE}"
    return _three(text, (ESTIMATE,), allowed, lambda I: min(I) > 0.0)


def mounting(text: str) -> str | list[float]:
    """A word of MOUNTINGS, or gravity (3,) m/s^2, base frame. Raises click.BadParameter for other text."""
    most = f"or gravity as three numbers with commas, up to {STRONGEST_m_s2:g} m/s^2"
    allowed = f"{', '.join(MOUNTINGS)}, {most}"
    return _three(text, tuple(MOUNTINGS), allowed, lambda g: hypot(*g) <= STRONGEST_m_s2)


class Question(NamedTuple):
    """One question of `hil new`, which is also an option on its command line."""

    key: str
    """Name of the answer with its unit; the option is the name without the unit."""
    text: str
    kind: Callable[[Any], Any]
    """Type of click, or a function."""
    default: Callable[[Answers], Any] | None = None
    """From the earlier answers; None: an answer is required."""
    trouble: Callable[[Answers], str | None] = lambda _: None
    """Reason why this answer cannot work with the earlier ones."""
    needed: Callable[[Answers], bool] = lambda _: True
    """True if the question applies, by the earlier answers."""

    @property
    def unit(self) -> str:
        """Unit of the answer; empty for an answer without a unit."""
        return self.kind.unit if isinstance(self.kind, Figure) else "kg m2" if self.kind is moments else ""

    @property
    def option(self) -> str:
        """Command-line option of the question, e.g. `--base-radius`."""
        end = "_" + self.unit.replace("/", "_").replace(" ", "_")
        return "--" + self.key.removesuffix(end).replace("_", "-")

    @property
    def allowed(self) -> str:
        """Unit and range of the answer, or its choices, as text; empty without either."""
        if isinstance(self.kind, click.Choice):
            return ", ".join(self.kind.choices)
        if isinstance(self.kind, Figure) and self.kind.max is not None:
            return f"{self.unit} {self.kind.min:g} to {self.kind.max:g}"
        return self.unit


def _stroke(a: Answers) -> str | None:
    low, stroke = a["length_min_m"], a["stroke_m"]
    if stroke >= low:
        return f"a telescopic leg of {low:g} m retracted length has a smaller stroke, given: {stroke:g}"
    if low <= (apart := joints_apart_m(a)):
        return (
            f"retracted legs of {low:g} m do not lift the platform: its joints are {apart:.4g} m from "
            "those of the base, seen from above; use longer legs, or more equal radii"
        )
    if not (number := condition_at_home(a)) < WORST_CONDITION:
        return (
            f"the condition number of J at mid-stroke is {number:.3g}, allowed: below {WORST_CONDITION:g}; "
            "reduce one radius, or the angle of the joint pairs"
        )
    return None


def _force(a: Answers) -> str | None:
    held, force = robot_at_home(a).held_N, a["drive_force_N"]
    needed = f"a leg carries {held:.4g} N at rest, and half the force is for motion: at least "
    return None if held <= HOLD_SHARE * force else f"{needed}{held / HOLD_SHARE:.4g} N, given: {force:g} N"


def _brakes(a: Answers) -> str | None:
    held, brake = robot_at_home(a).held_N, a["brake_force_N"]
    return f"a leg carries {held:.4g} N at rest: brakes of {brake:g} N slip" if brake < held else None


def _inertia(a: Answers) -> str | None:
    try:
        robot_at_home(a)
    except HilError as error:
        return str(error)
    return None


def _at_most(
    key: str, unit: str, most: Callable[[Answers], float], beyond: str
) -> Callable[[Answers], str | None]:
    """Check of an answer against a bound by the earlier answers; beyond: what a larger one means."""

    def trouble(a: Answers) -> str | None:
        return None if a[key] <= most(a) else f"{beyond}, allowed: at most {most(a):.4g} {unit}"

    return trouble


def _layout(a: Answers) -> str | None:
    own = drives.family(a).layout
    only = f"drives of {a['drives']} have {own} frames only, given: {a['layout']}"
    return only if drives.bought(a) and a["layout"] != own else None


def _circles(a: Answers) -> bool:
    return "base_joints_m" not in a


def _one_of(*names: str) -> click.Choice[str]:
    return click.Choice(names, case_sensitive=False)


QUESTIONS: tuple[Question, ...] = (
    Question(
        "base_radius_m", "radius of the circle of base joints", Figure("m", 1e-3, 100.0), needed=_circles
    ),
    Question("platform_radius_m", "radius of the circle of platform joints", Figure("m", 1e-3, 100.0)),
    Question(
        "base_half_angle_deg", "half the angle between a pair's joints on the base, pairs at 0, 120, 240 deg",
        Figure("deg", 0.0, 59.0), lambda _: 10.0, needed=_circles,
    ),
    Question(
        "platform_half_angle_deg", "the same angle on the platform, pairs at 60, 180, 300 deg",
        Figure("deg", 0.0, 59.0), lambda _: 10.0, needed=_circles,
    ),
    Question(
        "length_min_m", "length of a retracted leg, joint centre to joint centre", Figure("m", 1e-3, 100.0)
    ),
    Question("stroke_m", "stroke of a leg", Figure("m", 1e-4, 100.0), trouble=_stroke),
    Question(
        "mounting",
        f"base on the floor, a wall (-x down) or the ceiling: {', '.join(MOUNTINGS)}; or gravity as x,y,z",
        mounting, lambda _: "standing",
    ),
    Question("mass_kg", "mass of platform and all that is fixed to it", Figure("kg", 1e-3, 1e6)),
    Question(
        "com_height_m", "its centre of mass above the platform joints, away from the base",
        Figure("m", -100.0, 100.0), lambda _: 0.0, needed=lambda a: "com_m" not in a,
    ),
    Question(
        "inertia_kg_m2", "moments of inertia about its centre of mass, Ixx,Iyy,Izz; 'estimate' is a disc",
        moments, lambda _: ESTIMATE, _inertia,
    ),
    Question("leg_mass_kg", "mass of one leg with its motor; 0 neglects it", Figure("kg", 0.0, 1e5)),
    Question(
        "cylinder_mass_kg", "of it, mass of the half at the base joint: housing, motor, brake, screw",
        Figure("kg", 0.0, 1e5), lambda a: rounded(LOWER_SHARE * a["leg_mass_kg"], DIGITS),
        _at_most("cylinder_mass_kg", "kg", lambda a: a["leg_mass_kg"], "heavier than the whole leg"),
        lambda a: "cylinder_kg" not in a and a["leg_mass_kg"] > 0.0,
    ),
    Question("drive_force_N", "rated force of a drive", Figure("N", 1e-2, 1e7), trouble=_force),
    Question(
        "drive_speed_m_s", "largest speed of a drive", Figure("m/s", 1e-4, 50.0), None,
        _at_most("drive_speed_m_s", "m/s", lambda a: 50.0 * a["stroke_m"], "whole stroke in less than 20 ms"),
    ),
    Question(
        "reflected_mass_kg",
        "rotor and screw as a mass along the leg, or inertia@lead in kg m^2 and m a turn: a servo motor of "
        "5e-5 kg m^2 on a 5 mm screw, 5e-5@0.005, is 79 kg; 0 neglects it",
        MovingMass("kg", 0.0, 1e6), lambda _: 0.0,
    ),
    Question(
        "coulomb_friction_N",
        "dry friction of a leg; usual for a ball screw: 1 to 3 % of the rated force; `hil identify payload` "
        "measures it; 0 neglects it",
        Figure("N", 0.0, 1e6), lambda _: 0.0,
        _at_most("coulomb_friction_N", "N", lambda a: 0.5 * a["drive_force_N"], "over half the rated force"),
    ),
    Question(
        "viscous_friction_N_s_m", "friction of a leg per speed; 0 neglects it", Figure("N s/m", 0.0, 1e7),
        lambda _: 0.0,
    ),
    Question(
        "encoder_resolution_m", "one count of a leg's encoder", Figure("m", 1e-10, 1e-2), lambda _: 1e-6,
        _at_most("encoder_resolution_m", "m", lambda a: 1e-3 * a["stroke_m"], "below 1000 counts a stroke"),
    ),
    Question(
        "brake_force_N", "holding force of a closed brake; without a data sheet that of the drive",
        Figure("N", 1e-2, 1e7), lambda a: a["drive_force_N"], _brakes,
    ),
    Question(
        "brake_ms", "time until a brake has opened or closed", Figure("ms", 1.0, 1000.0), lambda _: 50.0
    ),
    Question(
        "interface", "CAN: localcan is virtual, on this machine; socketcan a Linux interface",
        _one_of("localcan", "socketcan"), lambda _: "localcan",
    ),
    Question(
        "drives", "drives: legs is our own protocol, the others are on the market", _one_of(*drives.FAMILIES),
        lambda _: drives.LEGS_PROTOCOL,
    ),
    Question(
        "model", "drive model, which sets the ranges in the frames", click.STRING, None, drives.model_trouble,
        drives.has_models,
    ),
    Question(
        "travel_m", "leg travel per turn that the drive reports: lead / gear, or 2 pi r of a pinion",
        Figure("m", 1e-5), None, derive.travel_trouble, drives.bought,
    ),
    Question(
        "layout", "frames: fd is CAN FD at 1 and 5 Mbit/s, classic 1 Mbit/s", _one_of("fd", "classic"),
        lambda a: drives.family(a).layout, _layout,
    ),
    Question(
        "channels", "number of CAN buses for the legs, each with its own interface",
        _one_of(*derive.CHANNELS), lambda _: derive.CHANNELS[0],
    ),
    Question(
        "rate_Hz", "rate of the loop", Figure("Hz", 10.0, 4000.0), derive.loop_rate_Hz, derive.rate_trouble,
    ),
)  # fmt: skip
"""In the order of the dialogue: each depends on earlier answers only."""
