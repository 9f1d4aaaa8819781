"""Rehearses a bring-up against emulated drives with deliberate mistakes, in simulated time.

Mistakes are given as text: `encoder_scale leg=2 value=1.01`, `ids_swapped leg=1 other=4 mounting`.
"""

from collections.abc import Callable, Sequence
from contextlib import closing
from math import nan

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from drivers.family import Family
from drivers.protocol import Frame, Received
from hil.app.compose import build_cycle, build_protocol
from hil.app.configuration.changes import unattended
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform, platform_dict
from hil.app.homing.last_pose import home_lengths, last_pose_of
from hil.app.sim.build import build_lockstep
from hil.lab.bringup.context import Request
from hil.lab.bringup.drives import Heard
from hil.lab.bringup.machine import known_poses, presses
from hil.loop.run_end import Ending
from plant_fmu.config import PlantSettings, StewartPlant
from plant_fmu.drives.nodes import Nodes
from plant_fmu.faults.plan import FaultPlan
from plant_fmu.plant import Plant, Robot
from plant_fmu.rehearsal.bench import RehearsalBench, Stand, WiredNodes, joints_of
from plant_fmu.rehearsal.wiring import MISTAKES, OF_WATCHDOG, Mistake, Wiring, legs_of, wired
from plant_fmu.stewart.plant import stewart_plant

COMMAND_SHARE = 0.4
"""Arrival of the command within a tick, as a share of the period."""
PATIENCE = 5
"""Refused readings before a rehearsal ends: a bench repeats its readings."""
Agree = Callable[[str, str, str], bool]
"""Asks for consent; arguments: title of a step, its effect, how to stop it."""
Say = Callable[[str], None]
UNLOADED = 0.5
"""Friction of a leg without load, as a share of its loaded friction."""


def emulated(c: Configuration) -> PlantSettings:
    """Section `plant` of the configuration; its model becomes the default Stewart model if it has another."""
    model = StewartPlant(type="stewart")
    if c.plant is None:
        return PlantSettings(model=model)
    return c.plant if isinstance(c.plant.model, StewartPlant) else c.plant.model_copy(update={"model": model})


def build_bench(
    c: Configuration, wiring: Wiring, seed: int = 1, faults: FaultPlan | None = None
) -> RehearsalBench:
    """Emulated bench: the machine's six loose legs on trestles, with a wiring and planned faults."""
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
    """Exchanges frames with an emulated bench, without transfer time. Mutable state: the tick, frames."""

    def __init__(self, nodes: Nodes, rate_Hz: float) -> None:
        self.rate_Hz = rate_Hz
        self._nodes = nodes
        self._period_ns = round(1e9 / rate_Hz)
        self._tick = -1
        self._pending: list[Received] = []
        nodes.start(0)

    def exchange(self, opening: Sequence[Frame]) -> Heard:
        """Advance by a tick; return the frames since the last tick and the answers to `opening`."""
        self._tick += 1
        t = self._tick * self._period_ns
        self._take(self._nodes.step(t, ()))
        self._take(self._nodes.step(t, [Received(t, frame) for frame in opening]))
        heard, self._pending = tuple(self._pending), []
        return Heard(t, heard)

    def send(self, frames: Sequence[Frame]) -> None:
        """Deliver frames to the emulated drives, at COMMAND_SHARE of the tick."""
        t = self._tick * self._period_ns + round(COMMAND_SHARE * self._period_ns)
        self._take(self._nodes.step(t, [Received(t, frame) for frame in frames]))

    def _take(self, sent: Sequence[tuple[int, Frame]]) -> None:
        self._pending += [Received(t, frame) for t, frame in sent]


class Hands:
    """An operator without a terminal: `agree` gives consent, `say` shows texts."""

    patience: float = PATIENCE

    def __init__(self, agree: Agree, say: Say) -> None:
        self._agree, self._say = agree, say

    def consent(self, title: str, will: str, stop: str) -> bool:
        """Ask for consent to a step through `agree`."""
        return self._agree(title, will, stop)

    def tell(self, text: str) -> None:
        """Show a text to the operator."""
        self._say(text)


class BenchHands(Hands):
    """Simulated operator who acts on an emulated bench and reads its gauges. Mutable state: the answer."""

    def __init__(
        self,
        bench: RehearsalBench,
        poses: Sequence[tuple[Array, Array]],
        agree: Agree = lambda *_: True,
        say: Say = lambda _: None,
        platform: Plant | None = None,
    ) -> None:
        super().__init__(agree, say)
        self._bench, self._poses, self._platform = bench, poses, platform
        self._answer: float | None = None

    def ask(self, request: Request) -> None:
        """Do the requested action, or take the reading, at the bench."""
        bench, self._answer = self._bench, 0.0
        match request.act:
            case "hang":
                bench.hang(*self._poses[round(request.value)])
            case "mount":
                assert self._platform is not None
                bench.cables.exchange(self._platform)
            case act:
                self._answer = bench.do(act, request.leg, request.value)
        if request.text:
            self._say(f"    {request.text}: {'done' if self._answer == 0.0 else f'{self._answer:.4f}'}")

    def answer(self) -> float | None:
        """The reading, or 0 for an action done; None after the first call for a request."""
        answer, self._answer = self._answer, None
        return answer


def mounted(c: Configuration, wiring: Wiring) -> Plant:
    """Plant model of the platform at home, with the mounting mistakes of `wiring`. Raises PlantError."""
    model, wiring = emulated(c).model, wiring.as_mounted
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


def six_legs(c: Configuration, bench: RehearsalBench) -> Ending:
    """Simulate the first motion of all six legs with the configuration found. Raises PlantError."""
    c = unattended(c)
    pose = last_pose_of(c, None)
    pose = None if pose is None else pose._replace(length=home_lengths(c))
    cycle = build_cycle(c, c.loop.rate_Hz, 1e-3 * c.drives.watchdog_ms, last_pose=pose)
    with closing(mounted(c, bench.wiring)) as plant:
        wiring = bench.wiring.as_mounted
        cables = bench.behind_cables(plant, wiring)
        nodes = WiredNodes(wiring, cables, bench.protocol, emulated(c).drives, c.drives)
        return build_lockstep(c, cycle, nodes).run(None, lambda *_: None)


_LEG_KEYS = ("leg", "other", "third")
MOUNTING = "mounting"
"""Last word of a mistake that is made when the platform is mounted."""


def mistake_of(words: str) -> Mistake:
    """Parse one mistake, e.g. `encoder_scale leg=2 value=1.01`. Raises ConfigurationError: invalid."""
    name, *rest = words.split() or [""]
    mounting = rest[-1:] == [MOUNTING]
    rest = rest[:-1] if mounting else rest
    if name not in MISTAKES:
        raise ConfigurationError(f"--mistake {words!r}: unknown, allowed: {', '.join(MISTAKES)}")
    keys = _LEG_KEYS[: legs_of(name)]
    _, _, of_size, what = MISTAKES[name]
    low, high = of_size[1:] or (0.0, 0.0)
    given = dict(word.split("=", 1) for word in rest if "=" in word)
    size = given.pop("value", None) if of_size[1:] else None
    try:
        value = None if size is None else float(size)
        legs = {key: int(text) for key, text in given.items()}
    except ValueError:
        legs, value = {}, nan
    many = len(legs) + (size is not None)
    if legs.keys() != set(keys) or many != len(rest) or not low <= (low if value is None else value) <= high:
        sizes = f" value={low:g} to {high:g}, {what}" if of_size[1:] else ""
        allowed = " ".join([name, *(f"{key}=0 to 5" for key in keys)])
        raise ConfigurationError(f"--mistake {words!r}: allowed: {allowed}{sizes} [{MOUNTING}]")
    return Mistake(name, **{"leg": 0, **legs}, value=value, mounting=mounting)


def wiring_of(mistakes: Sequence[str], protocol: Family) -> Wiring:
    """Wiring of an emulated bench with mistakes. Raises ConfigurationError: unknown, or without effect."""
    known = [mistake_of(words) for words in mistakes]
    if not protocol.traits.has_watchdog and not OF_WATCHDOG.isdisjoint(each.name for each in known):
        raise ConfigurationError(
            "--mistake: these drives have no watchdog that this program sets, allowed: all but "
            + ", ".join(sorted(OF_WATCHDOG))
        )
    try:
        wiring = wired(*known)
    except ValueError as error:
        raise ConfigurationError(f"--mistake: {error}") from None
    if known and wiring in (Wiring(), Wiring(mounting=Wiring())):
        raise ConfigurationError(f"--mistake {'; '.join(mistakes)!r}: no effect, allowed: a real change")
    return wiring
