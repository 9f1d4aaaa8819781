"""The rehearsal: the bring-up against emulated drives on the rehearsal bench, in simulated time.

Its mistakes come in words: `encoder_scale leg=2 value=1.01`, `ids_swapped leg=1 other=4`.
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
"""When in a tick its command arrives, as a share of the period."""
PATIENCE = 5
"""Readings that are refused before a rehearsal ends: a bench reads the same again."""
Agree = Callable[[str, str, str], bool]
"""Called with a step's title, what it will do and how to stop it."""
Say = Callable[[str], None]
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


class Hands:
    """An operator without a terminal: consent is asked of `agree`, and what is found is said."""

    patience: float = PATIENCE

    def __init__(self, agree: Agree, say: Say) -> None:
        self._agree, self._say = agree, say

    def consent(self, title: str, will: str, stop: str) -> bool:
        """Ask who rehearses."""
        return self._agree(title, will, stop)

    def tell(self, text: str) -> None:
        """Say what was found."""
        self._say(text)


class BenchHands(Hands):
    """The hands of a rehearsal: the bench's own truth, by tape and gauge. Mutable state: the answer."""

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
        """Do at the bench what is asked."""
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


def six_legs(c: Configuration, bench: RehearsalBench) -> Ending:
    """Run the first motion of a found configuration in lockstep, with its brake tests. Raises PlantError."""
    c = unattended(c)
    pose = last_pose_of(c, None)
    pose = None if pose is None else pose._replace(length=home_lengths(c))
    cycle = build_cycle(c, c.loop.rate_Hz, 1e-3 * c.drives.watchdog_ms, last_pose=pose)
    with closing(mounted(c, bench.wiring)) as plant:
        cables = bench.behind_cables(plant)
        nodes = WiredNodes(bench.wiring, cables, bench.protocol, emulated(c).drives, c.drives)
        return build_lockstep(c, cycle, nodes).run(None, lambda *_: None)


_LEG_KEYS = ("leg", "other", "third")


def mistake_of(words: str) -> Mistake:
    """Return a mistake. Raises ConfigurationError for words that are none, with those that are allowed."""
    name, *rest = words.split() or [""]
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
        raise ConfigurationError(f"--mistake {words!r}: allowed: {allowed}{sizes}")
    return Mistake(name, **{"leg": 0, **legs}, value=value)


def wiring_of(mistakes: Sequence[str], protocol: Family) -> Wiring:
    """Return the wiring with some mistakes. Raises ConfigurationError: unknown, impossible, or no mistake."""
    known = [mistake_of(words) for words in mistakes]
    if not protocol.traits.has_watchdog and not OF_WATCHDOG.isdisjoint(each.name for each in known):
        raise ConfigurationError(
            "--mistake: these drives have no watchdog that is set from here, allowed: all but "
            + ", ".join(sorted(OF_WATCHDOG))
        )
    try:
        wiring = wired(*known)
    except ValueError as error:
        raise ConfigurationError(f"--mistake: {error}") from None
    if known and wiring == Wiring():
        raise ConfigurationError(f"--mistake {'; '.join(mistakes)!r}: allowed: what changes something")
    return wiring
