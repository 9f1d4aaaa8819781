"""Data of a stability proof, from a configuration: robot, model of the law, reference, loop."""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from drivers import build_protocol
from drivers.arrays import Array
from drivers.errors import ConfigurationError, HilError
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.payload_box import Corner, corners
from hil.app.configuration.platform import build_platform
from hil.app.derive_encoder_limits import efficiencies, encoder_limits
from hil.app.loop_delay import loop_delay, observer_of, unlike_law
from hil.app.reachability import span_s
from hil.config.axis_model import AxisSpace
from hil.config.model import MechanicsSettings, ModelSettings
from hil.config.platform import PayloadSettings, PlatformSettings, PointShape
from hil.config.reference import LiveReference
from hil.control.law import LawSettings, per_leg
from hil.control.model import build_model
from hil.design.stability.delay_effect import (
    DelayEffect,
    LONG_s,
    delay_effect,
    demanding_stretches,
    stale_s,
)
from hil.design.stability.disturbance import Drives, Friction, Inertia, Linearised, Load, Local, Survey
from hil.design.stability.observed_loop import observed
from hil.design.stability.sampled_loop import Axis, Sampled, of_each
from hil.design.stability.ultimate import Aged, Extra, Judged, Ultimate, ultimate
from hil.mathematics.linear_algebra import condition_kernel
from hil.mathematics.linear_system import LinearSystem
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from hil.robot.kinematics import jacobian, jacobian_rate
from hil.robot.kinematics_kernels import jacobian_kernel, leg_lengths_kernel
from hil.safety.encoder_limits import UNASKED
from hil.trajectory.build import build_trajectory
from hil.trajectory.path import PoseSample, Trajectory
from plant_fmu.config import BenchPlant, StewartPlant

SAMPLES, APART_s = 101, 0.02
"""Fewest instants of a reference that are checked, and their distance on a long one, s."""
MOST = 501
GOLDEN = 0.6180339887498949
NO_LOAD = Load()


class Payload(NamedTuple):
    """Point mass fixed to the platform."""

    mass_kg: float = 0.0
    at_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """In the platform frame."""


NO_PAYLOAD = Payload()
NO_ERROR = 1e-4
"""m/s^2 or rad/s^2: largest disturbance that counts as none, and largest response to quantised readings.

The resolution of `legs`, 1 mN and 0.1 um, leaves less up to wn = 20 rad/s.
"""
SURVEYED = (
    "the disturbance of the loop, with delay and stale J and M, is nowhere larger than at the instants and "
    "extremes checked: surveyed, not enclosed"
)


@dataclass(frozen=True)
class Stated:
    """Uncertainties of load, masses and payload that the user states for a stability proof."""

    load: Load = NO_LOAD
    model_error: float = 0.0
    """Relative error of the modelled masses, in both directions."""
    payload: Payload = NO_PAYLOAD
    """Payload that may be on the platform, fully or not at all, and is not in the law's model."""

    @property
    def nothing(self) -> bool:
        """True if the user states no uncertainty."""
        return self.load == NO_LOAD and self.model_error == self.payload.mass_kg == 0.0


class Subject:
    """Data of a stability proof: robots, law's model, reference, loop delays and drives."""

    def __init__(
        self, c: Configuration, stated: Stated, tell: Callable[[float, float], None] = lambda *_: None
    ) -> None:
        """c: configuration; stated: uncertainties; tell: progress as in `delay_effect.delay_effect`."""
        self.c = c
        self.stated = stated
        self.tell = tell
        self.platform = build_platform(c.platform)
        self.radius = self.platform.radius
        plant = c.plant.model if c.plant is not None else None
        self.plant = plant if isinstance(plant, StewartPlant) else None
        self.on_bench = isinstance(plant, BenchPlant)
        """True if the plant is six uncoupled legs."""
        known = (c.controller.believed or MechanicsSettings()) if self.plant is None else self.plant
        reflected = known.reflected_mass_kg

        def robot(platform: Platform) -> Model:
            return Model(platform, leg_spin=c.platform.leg_spin, reflected_mass=reflected)

        boxes = corners(c.platform)
        if stated.payload.mass_kg:
            more = f"the stated {stated.payload.mass_kg:g} kg"
            boxes += [Corner(_laden(b.settings, stated.payload), f"{b.words} and {more}") for b in boxes]
        self.robots = [robot(build_platform(box.settings)) for box in boxes]
        """Robot of the model, at the corners of its payload's ranges, and each with the stated payload."""
        self.carried = [box.words for box in boxes]
        """Payload of each robot, in words."""
        try:
            self.trajectory = build_trajectory(c.reference, c.platform.home, c.folder)
            self.path = instants(self.trajectory)
        except ConfigurationError:
            raise
        except HilError as error:
            raise ConfigurationError(f"{c.source}: reference: {error}") from error
        self.axis = Axis(*loop_delay(c))
        self.observer = observer_of(c)
        self.peaks = peaks(self.platform, self.path)
        self.drives = drives_of(c, *self.peaks)
        """Resolution and losses of the drives."""
        limits = encoder_limits(c, c.loop.rate_Hz)
        self.push_N = limits.push_N if limits.watched_legs else np.zeros(6)
        """Probe push (6,) N of the safety rules on a leg at rest while legs stray from their path."""

    @property
    def robot(self) -> Model:
        """The robot; the last of several if its payload varies, see `alone`."""
        return self.robots[-1]

    def alone(self) -> list[Self]:
        """Copies of this object with one payload each."""
        found = []
        for robot, carried in zip(self.robots, self.carried, strict=True):
            one = copy(self)
            one.robots, one.carried = [robot], [carried]
            found.append(one)
        return found

    @property
    def nothing(self) -> bool:
        """True if neither user nor payload ranges state an uncertainty of robot and load."""
        return self.stated.nothing and len(self.robots) == 1

    @property
    def rest(self) -> bool:
        """True if the reference never moves."""
        return len(self.path) == 1

    @property
    def unseen(self) -> list[str]:
        """Assumptions of every proof as texts, except that a live reference rests."""
        taken = []
        b = self.c.controller.believed or MechanicsSettings()
        guessed = "with the friction and the reflected masses of the law's model"
        if not any(map(np.any, (b.reflected_mass_kg, b.viscous_friction_N_s_m, b.coulomb_friction_N))):
            guessed = "without friction and reflected mass"
        if self.c.plant is None:
            taken.append(f"the robot is the one of section platform, its drives without lag, {guessed}")
        elif self.plant is None and not self.on_bench:
            taken.append(f"the FMU is the robot of section platform, {guessed}")
        if span_s(self.trajectory) > LONG_s and not self.rest:
            taken.append(
                "the delay is felt most where the forces change most: on a reference longer than "
                f"{LONG_s:g} s only such stretches are computed"
            )
        if self.c.estimation.pose == "fused":
            lost = " and no encoder is lost" if self.c.estimation.fusion.may_lose_legs else ""
            taken.append(
                f"the fused pose is as good as measured lengths{lost}: the filter's own dynamics are not in "
                "the loop"
            )
        if self.c.feedforward is not None:
            taken.append(
                "the learned feed-forward compensates a disturbance: its possible error, "
                f"up to {self.c.feedforward.limit_N:g} N in a leg, is not in the bound"
            )
        return taken

    @property
    def live(self) -> list[str]:
        """Assumptions of a bound about a live reference, as texts; empty for another reference."""
        if not isinstance(self.c.reference, LiveReference):
            return []
        return ["the reference rests at home: the effect of its motion is not in the bound"]

    def wrench(self, law: LawSettings) -> list[str]:
        """Assumptions about the wrench that the law compensates; the loop contains an observer itself."""
        match self.c.estimation.wrench.source:
            case "sensor":
                return ["the wrench sensor is right but for the stated load"]
            case "observer" if unlike_law(self.c):
                return [f"the observer's model is the law's: estimation.wrench.model is not {law.law}'s"]
        return []

    def observing(self, controller: LinearSystem) -> LinearSystem:
        """Controller of an axis, together with the wrench observer if there is one."""
        return controller if self.observer is None else observed(controller, self.observer)

    def undisturbed(self, bound: Ultimate) -> bool:
        """True if no disturbance causes or sustains a tracking error."""
        keeps = max(float(bound.d.max()), float(bound.read.max()))
        fresh = self.c.limits.stale_warn_ticks == 1  # the rate of decay assumes fresh feedback
        return self.rest and self.nothing and bound.exact and keeps <= NO_ERROR and fresh

    def believed(self, settings: ModelSettings, scale: float = 1.0) -> Model:
        """Model of the law without friction, with its masses multiplied by `scale`."""
        bare = {
            "inertia_scale": settings.inertia_scale * scale,
            "viscous_friction_N_s_m": 0.0,
            "coulomb_friction_N": 0.0,
        }
        return build_model(settings.model_copy(update=bare), self.platform, self.c.platform.leg_spin)

    def friction(self, settings: ModelSettings) -> Friction:
        """Error of the friction that the law assumes; a foreign plant has the friction of the law's model.

        Dry friction holds a leg at rest, and the law still compensates the earlier rate: the two may add up.
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
        d: float = 0.0,
        alpha: float = 0.0,
    ) -> Judged:
        """All loops of a law with this model, and the worst error bound for the stated uncertainties.

        loops_of: the loop of each axis with a gain. ahead_s: prediction horizon of the law, s. d, m/s^2 for
        each leg, and alpha, the norm of Gamma - I: uncertainty stated in the law's own section.
        """
        ends = self.linearised(model, axes)
        words = [f", with {one}" if len(self.robots) > 1 else "" for one in self.carried]
        words = [one for one in words for _ in range(len(ends) // len(words))]
        found = [end.at(self.path, stale_s=stale_s(self.axis, ahead_s)) for end in ends]
        loops = [loops_of(Survey.of(local).gamma) for local in found]
        every = list({id(loop): loop for of_end in loops for loop in of_end}.values())
        for of_end, carried in zip(loops, words, strict=True):
            if not all(loop.stable for loop in of_end):
                return Judged(of_end, every, f"the loop is not stable{carried}", carried=carried)
        bounds: list[tuple[list[Sampled], Ultimate]] = []
        for end, local, of_end, carried in zip(ends, found, loops, words, strict=True):
            bound = self._bound(end, local, of_end, self._late(end, of_end, ahead_s), d, alpha)
            if isinstance(bound, str):
                return Judged(of_end, every, bound + carried, carried=carried)
            bounds.append((of_end, bound))
        worst = max(range(len(bounds)), key=lambda k: float(bounds[k][1].error.max()))
        inertia = Inertia.of(np.vstack([local.Gamma for local in found]))
        return Judged(bounds[worst][0], every, bounds[worst][1], inertia, tuple(bounds), words[worst])

    def _late(self, linearised: Linearised, loops: list[Sampled], ahead_s: float) -> DelayEffect:
        """Effect of the delays along the reference, for a law with the prediction horizon `ahead_s`, s."""
        if self.rest:
            return DelayEffect.none(stale_s(self.axis, ahead_s))
        trajectory = self.trajectory
        span, whole = span_s(trajectory), trajectory.duration_s
        stretches = [(0.0, span)]
        if span > LONG_s:
            stretches = demanding_stretches(linearised, trajectory, span, self.axis)
        elif whole is not None and whole > span:
            stretches.append((max(0.0, whole - 2.0 * span), whole))
        return delay_effect(
            linearised, trajectory, stretches, self.axis, loops, ahead_s, self.tell, self.observer
        )

    def _bound(
        self, end: Linearised, found: Local, loops: list[Sampled], late: DelayEffect, d: float, alpha: float
    ) -> Ultimate | str:
        """Error bound of the axes, with drives' errors and probe pushes; else why there is no bound."""
        of_legs = there_and_back = np.eye(6)
        if end.axes == "pose":
            J = [jacobian(self.platform, s.p, s.R) for s in self.path[:: max(1, len(self.path) // 20)]]
            to_pose = np.abs(np.linalg.inv(J))
            of_legs, there_and_back = to_pose.max(axis=0), (to_pose @ np.abs(J)).max(axis=0)
        length, rate = of_legs @ self.drives.length, of_legs @ self.drives.rate
        by_length = np.array(of_each(loops, Sampled.measured_gains)).T
        by_rate = np.array(of_each(loops, lambda loop: loop.measured_gains(rate=True))).T
        error, speed, effort, _ = by_length * length + by_rate * rate
        pushed = (np.abs(found.per_force) @ self.push_N).max(axis=0)
        if self.nothing and d == 0.0:
            pushed = np.zeros(6)
        old_s, aged = self.axis.period_s * (self.c.limits.stale_warn_ticks - 1), None
        if old_s > 0.0:
            read = by_rate[:3] + 0.5 * old_s * (by_length[:3] + np.eye(3)[:, :1])
            aged = Aged(old_s * of_legs @ self.peaks[1], old_s * there_and_back, read)
        drives = self.drives.disturb(found)
        extra = Extra(np.full(6, d), pushed, alpha, length + error, speed, effort, *drives, aged)
        return ultimate(end, self.path, found, loops, late, extra, condition=self.c.limits.condition)

    def linearised(self, settings: ModelSettings, axes: AxisSpace) -> list[Linearised]:
        """Robot under a law with this model, at each end of the stated inertia error."""
        alpha, load, friction = self.stated.model_error, self.stated.load, self.friction(settings)
        believed = [self.believed(settings, scale) for scale in sorted({1.0 - alpha, 1.0 + alpha})]
        return [Linearised(robot, model, axes, load, friction) for robot in self.robots for model in believed]

    def outside(self, p: Array, R: Array) -> str | None:
        """Limit that a pose violates, as text: a soft end of a leg or the condition of J; else None."""
        s, limits = self.c.platform, self.c.limits
        a, b = self.platform.base_joints, self.platform.platform_joints
        q = leg_lengths_kernel(a, b, p, R)
        if q.min() < s.length_min_m + limits.stroke_margin_m:
            return f"leg {int(np.argmin(q))} at its lower soft end"
        if q.max() > s.length_max_m - limits.stroke_margin_m:
            return f"leg {int(np.argmax(q))} at its upper soft end"
        number = condition_kernel(jacobian_kernel(a, b, p, R), self.radius)
        return None if number <= limits.condition else f"condition of J {limits.condition:g}"


def instants(trajectory: Trajectory) -> list[PoseSample]:
    """Reference sampled at evenly spaced instants; jittered if sparse; a single sample if at rest."""
    span = span_s(trajectory)
    count = min(max(SAMPLES, round(span / APART_s)), MOST)
    # Just inside the end, where the path still moves: outside it rests.
    times = np.linspace(0.0, span * (1 - 1e-12), count if span > 0.0 else 1)
    if count == MOST:  # even spacing would miss what repeats at the same interval
        times[1:-1] += (np.arange(1, MOST - 1) * GOLDEN % 1.0 - 0.5) * times[1]
    path = [PoseSample(*(np.array(part) for part in trajectory.sample(float(t)))) for t in times]
    moves = any(np.abs(s.twist).max() > 0.0 or np.abs(s.dtwist).max() > 0.0 for s in path)
    return path if moves else path[:1]


def peaks(platform: Platform, path: list[PoseSample]) -> tuple[Array, Array]:
    """Largest rate, m/s, and acceleration, m/s^2, of each leg along a path, (6,) each."""
    dq, ddq = np.zeros(6), np.zeros(6)
    for s in path:
        J, dJ = jacobian(platform, s.p, s.R), jacobian_rate(platform, s.p, s.R, s.twist)
        dq, ddq = np.maximum(dq, np.abs(J @ s.twist)), np.maximum(ddq, np.abs(J @ s.dtwist + dJ @ s.twist))
    return dq, ddq


def drives_of(c: Configuration, dq: Array, ddq: Array) -> Drives:
    """Resolution and losses of a configuration's drives, as disturbances of a proof.

    dq, ddq (6,): largest rate, m/s, and acceleration, m/s^2, of each leg along the path. An unrequested
    reading may be up to UNASKED periods older than its poll.
    """
    traits = build_protocol(c.bus, c.drives).traits
    read = traits.resolution.at(c.loop.rate_Hz)
    encoder_m = 0.0 if c.plant is None else c.plant.drives.encoder_resolution_m
    age_s = traits.stray(UNASKED, 0.0, c.loop.rate_Hz) / c.loop.rate_Hz
    driving, back_driving = efficiencies(c)
    return Drives(
        read.length + encoder_m + age_s * dq,
        read.rate + age_s * ddq,
        read.force / back_driving,
        1.0 / (driving * back_driving) - 1.0,
    )


def _laden(settings: PlatformSettings, payload: Payload) -> PlatformSettings:
    body = PayloadSettings(mass_kg=payload.mass_kg, com_m=payload.at_m, shape=PointShape(type="point"))
    carried = [*settings.platform.payload, body]
    return settings.model_copy(update={"platform": settings.platform.model_copy(update={"payload": carried})})
