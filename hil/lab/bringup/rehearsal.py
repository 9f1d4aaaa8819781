"""The rehearsal: the bring-up against emulated drives on the rehearsal bench, in simulated time.

Its mistakes come in words: `encoder_scale leg=2 value=1.01`, `ids_swapped leg=1 other=4`.
"""

from collections.abc import Callable, Sequence
from math import isfinite

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError, PlantError
from drivers.family import Family
from drivers.protocol import Frame, Received
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform, platform_dict
from hil.lab.bringup.context import Request
from hil.lab.bringup.drives import Heard
from hil.lab.bringup.machine import known_poses, presses
from plant_fmu.config import PlantSettings, StewartPlant
from plant_fmu.drives.nodes import Nodes
from plant_fmu.faults.plan import FaultPlan
from plant_fmu.plant import Plant, Robot
from plant_fmu.rehearsal.bench import RehearsalBench, Stand, joints_of
from plant_fmu.rehearsal.wiring import MISTAKES, OF_WATCHDOG, RANGES, Mistake, Wiring, legs_of, wired
from plant_fmu.stewart.plant import stewart_plant

COMMAND_SHARE = 0.4
"""When in a tick its command arrives, as a share of the period."""
PATIENCE = 5
"""Readings that are refused before a rehearsal ends: a bench reads the same again."""
UNLOADED = 0.5
"""Share of its friction that a leg without load has."""


def emulated(c: Configuration) -> PlantSettings:
    """Return the section `plant` with a platform: the configured one, or that of a machine without one."""
    model = StewartPlant(type="stewart")
    if c.plant is None:
        return PlantSettings(model=model)
    return c.plant if isinstance(c.plant.model, StewartPlant) else c.plant.model_copy(update={"model": model})


def build_bench(
    c: Configuration, wiring: Wiring, seed: int = 1, faults: FaultPlan | None = None
) -> RehearsalBench:
    """Return the bench of a configuration's machine on trestles, wired like that, with faults to come."""
    platform, plant = build_platform(c.platform), emulated(c)
    model = plant.model
    assert isinstance(model, StewartPlant)
    stand = Stand(
        mass_kg=float(platform.rod.mass) + model.reflected_mass_kg,
        friction_N=UNLOADED * model.coulomb_friction_N,
        brake_N=model.brake_force_N,
        length_min=c.platform.length_min_m,
        length_max=c.platform.length_max_m,
        base_joints=platform.base_joints,
        platform_joints=platform.platform_joints,
        platform_kg=float(platform.platform.mass),
        presses=presses(platform, *known_poses(c)[0]),
    )
    return RehearsalBench(build_protocol(c), plant.drives, c.drives, stand, wiring, seed, faults)


class BenchLine:
    """The bus between a bring-up and a bench, without bus time. Mutable state: the tick, frames under way."""

    def __init__(self, nodes: Nodes, rate_Hz: float) -> None:
        self.rate_Hz = rate_Hz
        self._nodes = nodes
        self._period_ns = round(1e9 / rate_Hz)
        self._tick = -1
        self._pending: list[Received] = []
        nodes.start(0)

    def exchange(self, opening: Sequence[Frame]) -> Heard:
        """Advance by a tick, and return what came since and what answers `opening`."""
        self._tick += 1
        t = self._tick * self._period_ns
        self._take(self._nodes.step(t, ()))
        self._take(self._nodes.step(t, [Received(t, frame) for frame in opening]))
        heard, self._pending = tuple(self._pending), []
        return Heard(t, heard)

    def send(self, frames: Sequence[Frame]) -> None:
        """Let the drives hear frames in the middle of the tick."""
        t = self._tick * self._period_ns + round(COMMAND_SHARE * self._period_ns)
        self._take(self._nodes.step(t, [Received(t, frame) for frame in frames]))

    def _take(self, sent: Sequence[tuple[int, Frame]]) -> None:
        self._pending += [Received(t, frame) for t, frame in sent]


def _not_mounted() -> Plant:
    raise PlantError("rehearsal: this bench has no platform to mount")


class BenchHands:
    """The operator of a rehearsal: the bench's own truth, measured by tape and gauge.

    Consent is asked of `agree`. Mutable state: the answer that has not been fetched.
    """

    patience: float = PATIENCE

    def __init__(
        self,
        bench: RehearsalBench,
        poses: Sequence[tuple[Array, Array]],
        agree: Callable[[str, str, str], bool] = lambda *_: True,
        say: Callable[[str], None] = lambda _: None,
        mounted: Callable[[], Plant] = _not_mounted,
    ) -> None:
        self._bench, self._poses, self._mounted = bench, poses, mounted
        self._agree, self._say = agree, say
        self._answer: float | None = None

    def consent(self, title: str, will: str, stop: str) -> bool:
        """Ask who rehearses."""
        return self._agree(title, will, stop)

    def tell(self, text: str) -> None:
        """Say it."""
        self._say(text)

    def ask(self, request: Request) -> None:
        """Do at the bench what is asked."""
        bench, self._answer = self._bench, 0.0
        match request.act:
            case "hang":
                bench.hang(*self._poses[round(request.value)])
            case "mount":
                bench.cables.exchange(self._mounted())
            case act:
                self._answer = bench.do(act, request.leg, request.value)
        if request.text:
            self._say(f"    {request.text}: {'done' if self._answer == 0.0 else f'{self._answer:.4f}'}")

    def answer(self) -> float | None:
        """Return what was measured, 0 for what is done."""
        answer, self._answer = self._answer, None
        return answer


def mounted(c: Configuration, wiring: Wiring) -> Plant:
    """Return the platform on its legs as they are mounted, at home. Raises PlantError."""
    model = emulated(c).model
    assert isinstance(model, StewartPlant)
    robot = platform_dict(c.platform) | {"leg_spin": c.platform.leg_spin}
    base, top = joints_of(wiring, np.array(robot["base_joints"]), np.array(robot["platform_joints"]))
    body = robot["platform"]
    inertia = wiring.payload * np.array(body["inertia"])
    there = {
        "base_joints": base.tolist(),
        "platform_joints": top.tolist(),
        "platform": body | {"mass": wiring.payload * body["mass"], "inertia": inertia.tolist()},
        "gravity": (wiring.gravity * np.array(robot["gravity"])).tolist(),
    }
    p, R = known_poses(c)[0]
    return stewart_plant(
        model,
        Robot(
            robot | there,
            length_min=np.full(6, c.platform.length_min_m),
            length_max=np.full(6, c.platform.length_max_m),
            p0=p + np.array([0.0, 0.0, wiring.home_off_m]),
            R0=R,
        ),
    )


_KEYS = ("leg", "other", "third", "value")


def mistake_of(words: str) -> Mistake:
    """Return a mistake. Raises ConfigurationError for an unknown mistake."""
    name, *rest = words.split() or [""]
    if name not in MISTAKES:
        raise ConfigurationError(f"--mistake {words!r}: unknown, allowed: {', '.join(MISTAKES)}")
    given = _given(words, rest)
    legs = {key: int(given[key]) for key in _KEYS[:3] if key in given}
    needed = _KEYS[: legs_of(name)]
    lacks = [key for key in needed if key not in given]
    more = [key for key in legs if key not in needed]
    if lacks or more or any(given[key] != leg for key, leg in legs.items()):
        wrong = f"without {', '.join(lacks)}" if lacks else f"given: {' '.join(rest)}"
        legs_words = f" with {', '.join(needed)}, legs 0 to 5" if needed else " without legs"
        raise ConfigurationError(f"--mistake {words!r}: {wrong}, allowed: {name}{legs_words}")
    value = given.get("value")
    if value is not None:
        _refuse_size(words, name, value)
    return Mistake(name, **{"leg": 0, **legs}, value=value)


def _given(words: str, rest: Sequence[str]) -> dict[str, float]:
    """Numbers by their keys. Raises ConfigurationError for the first word that is not one."""
    given: dict[str, float] = {}
    for word in rest:
        key, _, text = word.partition("=")
        if key not in _KEYS:
            raise ConfigurationError(f"--mistake {words!r}: {word!r}, allowed: {', '.join(_KEYS)} = a number")
        if key in given:
            raise ConfigurationError(f"--mistake {words!r}: {word!r}: {key} is given twice, allowed: once")
        try:
            given[key] = float(text)
        except ValueError:
            given[key] = float("nan")
        if not isfinite(given[key]):
            raise ConfigurationError(f"--mistake {words!r}: {word!r}, allowed: {key}= a finite number")
    return given


def _refuse_size(words: str, name: str, value: float) -> None:
    if name not in RANGES:
        raise ConfigurationError(f"--mistake {words!r}: {name} has no size, allowed: no value=")
    low, high = RANGES[name]
    if not low <= value <= high:
        raise ConfigurationError(
            f"--mistake {words!r}: value={value:g}, allowed: {low:g} to {high:g} ({MISTAKES[name][3]})"
        )


def wiring_of(mistakes: Sequence[str], protocol: Family) -> Wiring:
    """Return the wiring with some mistakes of drives of a protocol.

    Raises ConfigurationError for words that are no mistake, that these drives cannot make, or that together
    wire everything as it should be.
    """
    known = [mistake_of(words) for words in mistakes]
    for words, mistake in zip(mistakes, known, strict=True):
        if mistake.name in OF_WATCHDOG and not protocol.traits.has_watchdog:
            raise ConfigurationError(
                f"--mistake {words!r}: these drives have no watchdog that is set from here, "
                f"allowed: all but {', '.join(sorted(OF_WATCHDOG))}"
            )
    try:
        wiring = wired(*known)
    except ValueError as error:
        raise ConfigurationError(f"--mistake: {error}") from None
    if known and wiring == Wiring():
        raise ConfigurationError(
            f"--mistake {'; '.join(mistakes)!r}: nothing is wired wrongly by that, "
            "allowed: a size, or a set of mistakes, that changes something"
        )
    return wiring
