"""What `hil new` asks: one row a question, with unit, range, default and what cannot work."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from drivers.errors import HilError
from hil.app.new import derive, drives, fineness
from hil.app.new.robot import HOLD_SHARE, WORST_CONDITION, condition_at_home, joints_apart_m, robot_at_home
from hil.app.new.text import DIGITS
from hil.mathematics.rounding import rounded

Answers = dict[str, Any]
Trouble = Callable[[Answers], str | None]


@dataclass(frozen=True)
class Question:
    """One question of `hil new`, and its option on the command line."""

    key: str
    """Name of the answer with its unit; the option is this without the unit."""
    text: str
    unit: str = ""
    low: float = 0.0
    high: float = float("inf")
    default: Callable[[Answers], Any] | None = None
    """From the answers before; None: it has to be answered."""
    choices: tuple[str, ...] = ()
    trouble: Trouble = lambda _: None
    """What cannot work with this answer and those before; asked at once."""
    needed: Callable[[Answers], bool] = lambda _: True
    """From the answers before: whether it is a question at all."""

    @property
    def option(self) -> str:
        """Name of the option."""
        return "--" + self.key.removesuffix(f"_{self.unit.replace('/', '_').replace(' ', '_')}").replace(
            "_", "-"
        )

    @property
    def range_text(self) -> str:
        """Return unit and range, in brackets."""
        if self.choices:
            return f" ({', '.join(self.choices)})"
        ends = f"{self.low:g} to {self.high:g}" if self.high < float("inf") else ""
        return f" ({' '.join(word for word in (self.unit, ends) if word)})" if self.unit else ""

    def shown(self, default: Any) -> str | None:
        """Return a default as it is typed; None where there is none."""
        if self.default is None:
            return None
        return ESTIMATE if default is None else f"{default:g}" if isinstance(default, float) else str(default)

    def parse(self, text: str) -> Any:
        """Return the answer that a text is. Raises ValueError: no number, out of range, no such choice."""
        text = text.strip()
        if self.choices:
            if text.lower() not in self.choices:
                raise ValueError(f"allowed: {', '.join(self.choices)}, given: {text}")
            return text.lower()
        if self.key == "inertia_kg_m2":
            return _moments(text)
        if self.key == "model":
            return text
        value = _number(text, f" in {self.unit} without the unit")
        if not self.low <= value <= self.high:
            upper = f"{self.low:g} to {self.high:g}" if isfinite(self.high) else f"at least {self.low:g}"
            raise ValueError(f"allowed: {upper} {self.unit}, given: {value:g}")
        return value


SLOW_PLANT = "slow_plant"
"""Known before the first question: whether the plant is an FMU that needs its tool to run."""
ESTIMATE = "estimate"
"""Answer of who does not know the moments of inertia."""


def _number(text: str, unit: str = "") -> float:
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"allowed: a number{unit}, with a decimal point, given: {text}") from None
    if not isfinite(value):
        raise ValueError(f"allowed: a finite number, given: {text}")
    return rounded(value, DIGITS)


def _moments(text: str) -> list[float] | None:
    if text == ESTIMATE:
        return None
    try:
        values = [_number(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 3 or min(values) <= 0.0:
        raise ValueError(f"allowed: three numbers above 0 with commas, or {ESTIMATE}, given: {text}")
    return values


def _stroke(a: Answers) -> str | None:
    low, stroke = a["length_min_m"], a["stroke_m"]
    if stroke >= low:
        return (
            f"a telescopic leg of {low:g} m retracted length has less than {low:g} m of stroke, given: "
            f"{stroke:g}; lengths count from joint centre to joint centre"
        )
    apart = joints_apart_m(a)
    if low <= apart:
        return (
            f"retracted legs of {low:g} m do not lift the platform: its joints stand {apart:.4g} m beside "
            "those of the base; legs longer than that, or radii that are nearer, are needed"
        )
    number = condition_at_home(a)
    if not number < WORST_CONDITION:
        return (
            f"with these joints the legs hardly hold the platform at mid-stroke: the condition number of J "
            f"is {number:.3g}, allowed: less than {WORST_CONDITION:g}. Make one radius smaller, or the pairs "
            "of joints narrower: where the joints of both circles stand at equal angles nothing holds the "
            "rotation about z"
        )
    return None


def _force(a: Answers) -> str | None:
    held = float(np.abs(robot_at_home(a).static_N).max())
    if held > HOLD_SHARE * a["drive_force_N"]:
        return (
            f"a leg carries {held:.4g} N at rest, and drives of {a['drive_force_N']:g} N are to keep half of "
            f"their force for motion and control: at least {held / HOLD_SHARE:.4g} N are needed"
        )
    return None


def _brakes(a: Answers) -> str | None:
    held = float(np.abs(robot_at_home(a).static_N).max())
    if a["brake_force_N"] < held:
        return f"a leg carries {held:.4g} N at rest: brakes of {a['brake_force_N']:g} N slip"
    return None


def _inertia(a: Answers) -> str | None:
    if a["inertia_kg_m2"] is None:
        return None
    try:
        robot_at_home(a)
    except HilError as error:
        return str(error)
    return None


def _encoder(a: Answers) -> str | None:
    if a["encoder_resolution_m"] > 1e-3 * a["stroke_m"]:
        return (
            f"less than 1000 counts over the stroke: nothing is controlled by "
            f"{a['encoder_resolution_m']:g} m; at most {1e-3 * a['stroke_m']:.3g} m"
        )
    return None


def _speed(a: Answers) -> str | None:
    if a["drive_speed_m_s"] > 50.0 * a["stroke_m"]:
        return f"the whole stroke in less than 20 ms: more than {50 * a['stroke_m']:.3g} m/s has no room"
    return None


def _rate(a: Answers) -> str | None:
    trouble = derive.rate_trouble(a, a["rate_Hz"])
    if trouble is None:
        return fineness.rate_trouble(a)
    enough = derive.enough_channels(a, a["rate_Hz"])
    return trouble if enough is None else f"{trouble}; here --channels {enough} is enough"


def _layout(a: Answers) -> str | None:
    own = drives.family(a).layout
    if not drives.bought(a) or a["layout"] == own:
        return None
    return f"drives of {a['drives']} have {own} frames alone, given: {a['layout']}"


QUESTIONS: tuple[Question, ...] = (
    Question("base_radius_m", "radius of the circle of base joints", "m", 1e-3, 100.0),
    Question("platform_radius_m", "radius of the circle of platform joints", "m", 1e-3, 100.0),
    Question(
        "base_half_angle_deg", "half the angle between a pair's joints on the base, pairs at 0, 120, 240 deg",
        "deg", 0.0, 59.0, lambda _: 10.0,
    ),
    Question(
        "platform_half_angle_deg", "the same on the platform (pairs at 60, 180, 300 deg)",
        "deg", 0.0, 59.0, lambda _: 10.0,
    ),
    Question("length_min_m", "length of a retracted leg, joint centre to joint centre", "m", 1e-3, 100.0),
    Question("stroke_m", "stroke of a leg", "m", 1e-4, 100.0, trouble=_stroke),
    Question(
        "mounting", "does the platform stand on the base or hang below it",
        default=lambda _: "standing", choices=("standing", "hanging"),
    ),
    Question("mass_kg", "mass of platform and all that is fixed to it", "kg", 1e-3, 1e6),
    Question(
        "com_height_m", "its centre of mass above the platform joints, away from the base", "m",
        -100.0, 100.0, lambda _: 0.0,
    ),
    Question(
        "inertia_kg_m2", "moments of inertia about its centre of mass, Ixx,Iyy,Izz; 'estimate' is a disc",
        "kg m2", default=lambda _: None, trouble=_inertia,
    ),
    Question("leg_mass_kg", "mass of one leg with its motor; 0 neglects it", "kg", 0.0, 1e5),
    Question("drive_force_N", "rated force of a drive", "N", 1e-2, 1e7, trouble=_force),
    Question("drive_speed_m_s", "largest speed of a drive", "m/s", 1e-4, 50.0, trouble=_speed),
    Question(
        "reflected_mass_kg", "rotor and screw along the leg, inertia x (2 pi / lead)^2; 0 neglects it", "kg",
        0.0, 1e6, lambda _: 0.0,
    ),
    Question(
        "encoder_resolution_m", "one count of a leg's encoder", "m", 1e-10, 1e-2, lambda _: 1e-6,
        trouble=_encoder,
    ),
    Question(
        "brake_force_N", "force that a closed brake holds; for want of a data sheet, as the drive", "N",
        1e-2, 1e7, lambda a: a["drive_force_N"], trouble=_brakes,
    ),
    Question("brake_ms", "time until a brake has opened or closed", "ms", 1.0, 1000.0, lambda _: 50.0),
    Question(
        "interface", "CAN: localcan is virtual, on this machine; socketcan a Linux interface",
        default=lambda _: "localcan", choices=("localcan", "socketcan"),
    ),
    Question(
        "drives", "drives: legs is our own protocol, the others can be bought",
        default=lambda _: drives.LEGS_PROTOCOL, choices=tuple(drives.FAMILIES),
    ),
    Question(
        "model", "their model, whose ranges the frames have",
        trouble=drives.model_trouble, needed=drives.has_models,
    ),
    Question(
        "travel_m", "leg length a turn that the drive reports: lead over gear, or 2 pi r of a pinion",
        "m", 1e-5, trouble=fineness.travel_trouble, needed=drives.bought,
    ),
    Question(
        "layout", "frames: fd is CAN FD at 1 and 5 Mbit/s, classic 1 Mbit/s",
        default=lambda a: drives.family(a).layout, choices=("fd", "classic"), trouble=_layout,
    ),
    Question(
        "channels", "CAN buses over which the legs are spread, each with an interface of its own",
        default=lambda _: derive.CHANNELS[0], choices=derive.CHANNELS,
    ),
    Question(
        "rate_Hz", "rate of the loop", "Hz", 10.0, 4000.0,
        lambda a: derive.loop_rate_Hz(a, slow=a.get(SLOW_PLANT, False)),
        trouble=_rate,
    ),
)  # fmt: skip
"""In the order in which they are asked: each looks at the answers before it only."""
