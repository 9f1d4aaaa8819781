"""The rehearsal: the bring-up against emulated drives on the rehearsal bench, in simulated time."""

from collections.abc import Callable, Sequence

import numpy as np

from drivers.arrays import Array
from drivers.errors import PlantError
from drivers.protocol import Frame, Received
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform, platform_dict
from hil.lab.bringup.context import Request
from hil.lab.bringup.line import Heard
from hil.lab.bringup.machine import known_poses, presses
from plant_fmu.config import PlantSettings, StewartPlant
from plant_fmu.drives.nodes import Nodes
from plant_fmu.faults.plan import FaultPlan
from plant_fmu.plant import Plant, Robot
from plant_fmu.rehearsal.bench import RehearsalBench, Stand, joints_of
from plant_fmu.rehearsal.wiring import Wiring
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
