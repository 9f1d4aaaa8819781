"""From a configuration to what the theorems speak of: robot, belief, reference, loop."""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from drivers.arrays import Array
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.payload_box import Corner, corners
from hil.app.configuration.platform import build_platform
from hil.app.encoder_limits import encoder_limits
from hil.app.loop_delay import loop_delay
from hil.app.reachability import span_s
from hil.app.stability.imperfect_drives import Disturbed, Drives
from hil.app.stability.instants import instants
from hil.app.stability.judged import NOTHING, Inertia, Judged, Unknown
from hil.config.axis_model import AxisSpace
from hil.config.model import MechanicsSettings, ModelSettings
from hil.config.platform import PayloadSettings, PlatformSettings, PointShape
from hil.config.reference import LiveReference
from hil.control.law import per_leg
from hil.control.model import build_model
from hil.design.stability.disturbance import Friction, Linearised, Load, Local, Survey
from hil.design.stability.lateness import Late, late, stale_s
from hil.design.stability.sampled import Axis, Sampled, of_each
from hil.design.stability.ultimate import Extra, Ultimate, ultimate
from hil.mathematics.linear_algebra import condition_kernel
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from hil.robot.kinematics import jacobian
from hil.robot.kinematics_kernels import jacobian_kernel, leg_lengths_kernel
from hil.trajectory.build import build_trajectory
from plant_fmu.config import BenchPlant, StewartPlant

NO_LOAD = Load()


class Payload(NamedTuple):
    """A point mass fixed to the platform."""

    mass_kg: float = 0.0
    at_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """In the platform frame."""


NO_PAYLOAD = Payload()
NO_ERROR = 1e-4
"""m/s^2 or rad/s^2: a disturbance that counts as none, of an exact model; likewise what the steps of the
readings make a law ask for. The steps of 1 mN and 0.1 um of `legs` leave less, up to wn = 20 rad/s."""
SURVEYED = (
    "what disturbs the loop, delay and stale J and M included, is no more than at the instants and extremes "
    "looked at: surveyed, not enclosed"
)


@dataclass(frozen=True)
class Stated:
    """What the user says the law does not know."""

    load: Load = NO_LOAD
    model_error: float = 0.0
    """Believed masses are off by this share, either way."""
    payload: Payload = NO_PAYLOAD
    """Rides on the platform, all of it or nothing, and the law does not know of it."""

    @property
    def nothing(self) -> bool:
        """Tell whether nothing is stated."""
        return self.load == NO_LOAD and self.model_error == self.payload.mass_kg == 0.0


class Subject:
    """A configuration as the theorems see it."""

    def __init__(
        self, c: Configuration, stated: Stated, tell: Callable[[float, float], None] = lambda *_: None
    ) -> None:
        """Take a configuration and what is stated beside it; tell as for `lateness.late`."""
        self.c = c
        self.stated = stated
        self.tell = tell
        self.platform = build_platform(c.platform)
        plant = c.plant.model if c.plant is not None else None
        self.plant = plant if isinstance(plant, StewartPlant) else None
        self.on_bench = isinstance(plant, BenchPlant)
        """Six uncoupled legs."""
        known = (c.controller.believed or MechanicsSettings()) if self.plant is None else self.plant
        reflected = known.reflected_mass_kg

        def robot(platform: Platform) -> Model:
            return Model(platform, leg_spin=c.platform.leg_spin, reflected_mass=reflected)

        boxes = corners(c.platform)
        if stated.payload.mass_kg:
            more = f"the stated {stated.payload.mass_kg:g} kg"
            boxes += [Corner(_laden(b.settings, stated.payload), f"{b.words} and {more}") for b in boxes]
        self.robots = [robot(build_platform(box.settings)) for box in boxes]
        """That of the model, those at the corners of its payload's ranges; all these with what is stated."""
        self.carried = [box.words for box in boxes]
        """What each of them carries."""
        self.path = instants(c)
        self.axis = Axis(*loop_delay(c))
        self.drives = Drives.of(c)
        """Their steps and losses."""
        limits = encoder_limits(c, c.loop.rate_Hz)
        self.push_N = limits.push_N if limits.watched_legs else np.zeros(6)
        """By which safety pushes a leg that stands still while others stray."""

    @property
    def robot(self) -> Model:
        """The robot, one of them where its payload varies; see `alone`."""
        return self.robots[-1]

    def alone(self) -> list[Self]:
        """Return a subject for each robot."""
        found = []
        for robot, carried in zip(self.robots, self.carried, strict=True):
            one = copy(self)
            one.robots, one.carried = [robot], [carried]
            found.append(one)
        return found

    @property
    def nothing(self) -> bool:
        """Tell whether the law knows the robot and all that acts on it, as far as anybody states it."""
        return self.stated.nothing and len(self.robots) == 1

    @property
    def rest(self) -> bool:
        """Tell whether the reference never moves."""
        return len(self.path) == 1

    @property
    def unseen(self) -> list[str]:
        """What a proof has to take for granted, beside that a live reference rests."""
        taken = []
        if self.c.plant is None:
            taken.append(f"the robot is as section platform says, its drives without lag, {self._guessed}")
        elif self.plant is None and not self.on_bench:
            taken.append(f"the FMU is the robot of section platform, {self._guessed}")
        if self.c.estimation.pose == "fused":
            lost = " and no encoder is lost" if self.c.estimation.fusion.may_lose_legs else ""
            taken.append(
                f"the fused pose is as good as measured lengths{lost}: the filter's own dynamics are not in "
                "the loop"
            )
        if self.c.feedforward is not None:
            taken.append(
                "the learned feed-forward takes off what disturbs the loop: what it adds where it is wrong, "
                f"up to {self.c.feedforward.limit_N:g} N in a leg, is not in the bound"
            )
        return taken

    @property
    def _guessed(self) -> str:
        """What is taken for granted of drives that no section of ours describes."""
        b = self.c.controller.believed or MechanicsSettings()
        if not any(map(np.any, (b.reflected_mass_kg, b.viscous_friction_N_s_m, b.coulomb_friction_N))):
            return "without friction and reflected mass"
        return "with the friction and the reflected masses that the law believes"

    @property
    def live(self) -> list[str]:
        """What a bound takes for granted of a reference that is not known beforehand."""
        if not isinstance(self.c.reference, LiveReference):
            return []
        return ["the reference rests at home: what its motion costs is not in the bound"]

    @property
    def wrench(self) -> list[str]:
        """What is taken for granted where the law takes an estimated wrench off: a feedback of its own."""
        if self.c.estimation.wrench.source == "none":
            return []
        return ["the estimated wrench is right but for the stated load"]

    def undisturbed(self, bound: Ultimate) -> bool:
        """Tell whether nothing brings errors about that were not there at the start, or keeps them."""
        keeps = max(float(bound.d.max()), float(bound.read.max()))
        return self.rest and self.nothing and bound.exact and keeps <= NO_ERROR

    @property
    def delay(self) -> str:
        """The delay of the loop, in milliseconds, and whether the lag of the drives is in it."""
        lag = "" if self.axis.lag_s > 0.0 else ", no lag of the drives known"
        return f"{1e3 * self.axis.transport_s:g} ms from measurement to force{lag}"

    def believed(self, settings: ModelSettings, scale: float = 1.0) -> Model:
        """Return the law's model without its friction, masses times `scale` once more."""
        bare = {
            "inertia_scale": settings.inertia_scale * scale,
            "viscous_friction_N_s_m": 0.0,
            "coulomb_friction_N": 0.0,
        }
        return build_model(settings.model_copy(update=bare), self.platform, self.c.platform.leg_spin)

    def friction(self, settings: ModelSettings) -> Friction:
        """Return what the law's friction is wrong by; where the plant is none of ours it has what that is.

        Dry friction holds a leg that stands, and the law answers the rate it had: both may add up.
        """
        viscous, coulomb = per_leg(settings.viscous_friction_N_s_m), per_leg(settings.coulomb_friction_N)
        if self.plant is None:
            return Friction(np.zeros(6), 2.0 * coulomb)
        return Friction(
            np.abs(self.plant.viscous_friction_N_s_m - viscous), self.plant.coulomb_friction_N + coulomb
        )

    def judged(
        self,
        model: ModelSettings,
        axes: AxisSpace,
        loops_of: Callable[[float], list[Sampled]],
        ahead_s: float = 0.0,
        unknown: Unknown = NOTHING,
    ) -> Judged:
        """Return loops and bound of a law with this model: all loops, and the worst bound, of what is stated.

        loops_of: the loop of each axis with a gain. ahead_s: how far the law looks ahead.
        """
        stale = stale_s(self.axis, ahead_s)
        looked = []
        every: dict[int, Sampled] = {}
        for linearised, carried in self._ends(model, axes):
            found = linearised.at(self.path, stale_s=stale)
            loops = loops_of(Survey.of(found).gamma)
            looked.append((linearised, carried, found, loops))
            every |= {id(loop): loop for loop in loops}
        all_loops = list(every.values())
        for _, carried, _, loops in looked:
            if not all(loop.stable for loop in loops):
                return Judged(loops, all_loops, f"the loop is not stable{carried}", carried=carried)
        ends: list[tuple[list[Sampled], Ultimate]] = []
        for linearised, carried, found, loops in looked:
            late = self._late(linearised, loops, ahead_s)
            bound = self._least(linearised, loops, late, unknown, found)
            if isinstance(bound, str):
                return Judged(loops, all_loops, bound + carried, carried=carried)
            ends.append((loops, bound))
        worst = max(range(len(ends)), key=lambda k: float(ends[k][1].error.max()))
        loops, bound = ends[worst]
        inertia = Inertia.of(np.vstack([found.Gamma for _, _, found, _ in looked]))
        return Judged(loops, all_loops, bound, inertia, tuple(ends), looked[worst][1])

    def _ends(self, model: ModelSettings, axes: AxisSpace) -> list[tuple[Linearised, str]]:
        """Return `linearised`, each with the words for what it carries where that is not one thing."""
        robots = self.linearised(model, axes)
        each = len(robots) // len(self.robots)
        several = len(self.robots) > 1
        words = [f", with {words}" if several else "" for words in self.carried for _ in range(each)]
        return list(zip(robots, words, strict=True))

    def _late(self, linearised: Linearised, loops: list[Sampled], ahead_s: float) -> Late:
        """Return what the delays cost along the reference, under a law that looks ahead by `ahead_s`."""
        if self.rest:
            return Late.none(stale_s(self.axis, ahead_s))
        trajectory = build_trajectory(self.c.reference, self.c.platform.home, self.c.folder)
        span, whole = span_s(trajectory), trajectory.duration_s
        stretches = [(0.0, span)]
        if whole is not None and whole > span:
            stretches.append((max(0.0, whole - 2.0 * span), whole))
        return late(linearised, trajectory, stretches, self.axis, loops, ahead_s, self.tell)

    def _least(
        self, linearised: Linearised, loops: list[Sampled], late: Late, unknown: Unknown, found: Local
    ) -> Ultimate | str:
        """Return the lower bound of those by what is known of the forces that drives lose, or why none."""
        best: Ultimate | str | None = None
        for by_drives in self.drives.disturb(linearised, self.path, found):
            more = self._unknown(loops, linearised.axes, unknown, found, by_drives)
            condition = self.c.limits.condition
            bound = ultimate(linearised, self.path, found, loops, late, more, condition=condition)
            if best is None or (
                not isinstance(bound, str)
                and (isinstance(best, str) or float(bound.error.max()) < float(best.error.max()))
            ):
                best = bound
        assert best is not None
        return best

    def _unknown(
        self,
        loops: list[Sampled],
        axes: AxisSpace,
        unknown: Unknown,
        found: Local,
        by_drives: Disturbed,
    ) -> Extra:
        """Return what is stated, what steps of the readings cost, the drives' part, and pushes of legs."""
        pushed = (np.abs(found.per_force) @ self.push_N).max(axis=0)
        length, rate = self.drives.length, self.drives.rate
        if axes == "pose":
            J = [jacobian(self.platform, s.p, s.R) for s in self.path[:: max(1, len(self.path) // 20)]]
            to_pose = np.max(np.abs([np.linalg.inv(one) for one in J]), axis=0)
            length, rate = to_pose @ length, to_pose @ rate
        by_length = np.array(of_each(loops, Sampled.measured_gains))
        by_rate = np.array(of_each(loops, lambda loop: loop.measured_gains(rate=True)))
        if self.nothing and unknown.d == 0.0:
            pushed = np.zeros(6)
        return Extra(
            d=np.full(6, unknown.d),
            pushed=pushed,
            alpha=unknown.alpha,
            error=(1.0 + by_length[:, 0]) * length + by_rate[:, 0] * rate,
            rate=by_length[:, 1] * length + by_rate[:, 1] * rate,
            effort=by_length[:, 2] * length + by_rate[:, 2] * rate,
            drives=by_drives.d,
            lost=by_drives.lost,
        )

    def linearised(self, settings: ModelSettings, axes: AxisSpace) -> list[Linearised]:
        """Return the robot under a law with this model, at each end of what is stated of its inertia."""
        alpha, load, friction = self.stated.model_error, self.stated.load, self.friction(settings)
        believed = [self.believed(settings, scale) for scale in sorted({1.0 - alpha, 1.0 + alpha})]
        return [Linearised(robot, model, axes, load, friction) for robot in self.robots for model in believed]

    def outside(self, p: Array, R: Array) -> str | None:
        """Say which limit a pose breaks: the soft ends of a leg, or the condition of J."""
        s, limits = self.c.platform, self.c.limits
        a, b = self.platform.base_joints, self.platform.platform_joints
        q = leg_lengths_kernel(a, b, p, R)
        if q.min() < s.length_min_m + limits.stroke_margin_m:
            return f"leg {int(np.argmin(q))} at its lower soft end"
        if q.max() > s.length_max_m - limits.stroke_margin_m:
            return f"leg {int(np.argmax(q))} at its upper soft end"
        number = condition_kernel(jacobian_kernel(a, b, p, R), self.platform.radius)
        return None if number <= limits.condition else f"condition of J {limits.condition:g}"


def _laden(settings: PlatformSettings, payload: Payload) -> PlatformSettings:
    body = PayloadSettings(mass_kg=payload.mass_kg, com_m=payload.at_m, shape=PointShape(type="point"))
    carried = [*settings.platform.payload, body]
    return settings.model_copy(update={"platform": settings.platform.model_copy(update={"payload": carried})})
