"""Data of `hil check`: a configuration, the motion along its reference, and values derived from both."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError, HilError
from drivers.family import Family
from hil.app.adapter.qualification import answered_ns
from hil.app.check.demand import (
    JogDemand,
    Learned,
    Silence,
    SpeedChange,
    clipped,
    jog_demand,
    learned,
    speed_change,
)
from hil.app.compose import build_admission, build_protocol
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.controller_file import controller_of
from hil.app.configuration.payload_box import corners
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.app.configuration.yaml_positions import Path, Problem, parse
from hil.app.derive_encoder_limits import encoder_limits
from hil.app.loop_delay import LoopDelay, loop_delay, observer_of
from hil.app.reachability import IN_MM, Violation, Walk, span_s, violations, walk
from hil.app.unknown_payload import UnknownPayload, force_steps_N, stepped_error_m, unknown_payload
from hil.config.linear_controller import LinearController
from hil.config.reference import LiveReference, SampledReference
from hil.control.law import ErrorDynamics
from hil.control.margin import cross_over, phase_margin_deg
from hil.control.state_space import StateSpaceSettings
from hil.design.stability.observed_loop import Observer, observed
from hil.design.stability.sampled_loop import Axis, analyse, gains, sampled_controller
from hil.mathematics.rotations import rotation_from_vector
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from hil.safety.encoder_limits import EncoderLimits
from hil.signals import explain
from hil.trajectory.build import build_trajectory
from hil.trajectory.path import Trajectory, axis_limits, pose_coordinates
from hil.trajectory.sampled import read_poses, roughness
from plant_fmu.config import BenchPlant, StewartPlant


class LoopFinding(NamedTuple):
    """Lines, figures and warnings of `hil check` about a designed controller's loop."""

    lines: list[str]
    figures: dict[str, Any]
    warnings: list[str]


def designed_loop(
    name: str,
    controller: LinearController,
    delay: LoopDelay,
    observer: Observer | None,
) -> LoopFinding:
    """Stability margins of controller `name`, with a warning below LEAST_MARGIN_DEG degrees.

    observer: observer of the wrench, if the controller compensates its estimate.
    """
    sampled = sampled_controller(controller)
    loop = analyse(Axis(*delay), sampled if observer is None else observed(sampled, observer))
    transport_ms, lag_ms = 1e3 * delay.transport_s, 1e3 * delay.lag_s
    radius, left, order = loop.largest, loop.margins, len(controller.A)
    figures = {
        "order": order, "method": controller.method, "axes": controller.axes, "rate_Hz": controller.rate_Hz,
        "transport_ms": transport_ms, "lag_ms": lag_ms, "pole_radius": radius,
    }  # fmt: skip
    what = f"controller {name}: {controller.method}, order {order} on each {controller.axes} axis"
    delays, trouble = f"{transport_ms:.1f} ms of transport and {lag_ms:.1f} ms of lag", None
    if observer is not None:
        delays += f" and the observer of {observer.bandwidth_Hz:g} Hz"
    if left is None:
        line = f"unstable with {delays}"
        trouble = f"{line}: a pole of the sampled loop at {radius:.4f}, allowed: below 1"
    else:
        figures |= {
            "cross_over_rad_s": left.crossover_rad_s,
            "phase_margin_deg": left.phase_deg,
            "sensitivity_peak": left.peak_S,
        }
        line = (
            f"crosses over at {left.crossover_rad_s:.0f} rad/s; {delays} leave {left.phase_deg:.0f} degrees "
            f"of phase margin, sensitivity at most {left.peak_S:.2f}"
        )
        if left.phase_deg < LEAST_MARGIN_DEG:
            trouble = (
                f"about {left.phase_deg:.0f} degrees of phase margin with {delays}, advised: at least "
                f"{LEAST_MARGIN_DEG:g}"
            )
    warnings = [] if trouble is None else [f"controller.controller_file: {trouble}; design for this delay"]
    return LoopFinding([what, line], figures, warnings)


if TYPE_CHECKING:
    from hil.app.stability.assessment import Assessment
    from plant_fmu.fmu.probe import Probe


LEAST_MARGIN_DEG = 30.0
"""Phase margin, degrees, below which `hil check` warns."""


def course(c: Configuration) -> tuple[Model, Trajectory, float, Walk]:
    """(robot, reference, its checked duration in s, leg motion along it) of a configuration.

    Raises ConfigurationError with each violated limit and its first instant.
    """
    model, period_s = robot(c), 1.0 / c.loop.rate_Hz
    try:
        trajectory = build_trajectory(c.reference, c.platform.home, c.folder)
        span = span_s(trajectory)
        w = walk(model.platform, model, trajectory, span, period_s, c.plant)
    except ConfigurationError:
        raise
    except HilError as error:
        raise refused(c, str(error)) from error
    broken = violations(w, c.platform, c.limits, period_s)
    rough = rough_rows(c) if broken else ""
    broken = [v for v in broken if not rough or v.limit != IN_MM]
    found = [f"at t = {v.t:.3f} s: {v.message}" for v in broken] + [rough] * bool(rough)
    if isinstance(c.reference, LiveReference) and not found:
        against = build_admission(c, model.platform)(pose_coordinates(c.reference.start or c.platform.home))
        found = [f"at its start, set-points are refused: {explain(against)}"] if against else []
    if found:
        raise refused(c, *found)
    clips = clipped(c, encoder_limits(c, c.loop.rate_Hz), w)
    if clips is not None:
        raise refused(c, clips, path=("monitor", "friction_N"))
    return model, trajectory, span, w


def rough_rows(c: Configuration) -> str:
    """Reason why the rows of a CSV reference make the path rougher than intended; "" without."""
    if not isinstance(c.reference, SampledReference):
        return ""
    rough = roughness(*read_poses(c.folder / c.reference.path, at_least=2))
    return rough and f"{c.reference.path}: {rough}"


def refused(c: Configuration, *messages: str, path: Path = ("reference",)) -> ConfigurationError:
    """Error that points at a key of the configuration file, or at its nearest ancestor there."""
    position = parse(c.text).key_position(path)
    return ConfigurationError(*(Problem(position, path, each).line(c.source) for each in messages))


def robot(c: Configuration) -> Model:
    """Robot of a configuration with the payload of the controller's model."""
    return Model(build_platform(c.platform), leg_spin=c.platform.leg_spin)


def static_N(c: Configuration, model: Model) -> Array:
    """Leg forces (6,) N, pushing positive, that hold the platform at home."""
    still = np.zeros(6)
    return model.inverse_dynamics(*pose_arrays(c.platform.home), still, still)


@dataclass
class Subject:
    """A configuration, and values that several figures and warnings of `hil check` share, computed once.

    The sections of the report set `proven`, `adapters`, `fifo`, and `probe` to `notes`.
    """

    c: Configuration
    tell: Callable[[float, float], None]
    """Progress callback, called with checked and total seconds of the reference."""
    model: Model
    trajectory: Trajectory
    span_s: float
    walk: Walk
    proven: "Assessment | None" = None
    """Stability result of the law."""
    probe: "Probe | None" = None
    """Response of the user's own FMU to small pushes; None for another plant."""
    tool: str = ""
    """Tool that generated the FMU."""
    needs_tool: bool = False
    unfit_step: str = ""
    """Problem with the communication step by the FMU's description; empty without."""
    notes: list[str] = field(default_factory=list)
    """Messages that the FMU has reported."""
    adapters: list[str] = field(default_factory=list)
    """What speaks against the CAN adapters, by their qualifications."""
    fifo: bool = True
    """True if this machine grants SCHED_FIFO."""

    def __post_init__(self) -> None:
        c, w = self.c, self.walk
        self.period_s, self.window_us = 1.0 / c.loop.rate_Hz, 1e6 * c.loop.window_s(c.loop.rate_Hz)
        self.protocol: Family = build_protocol(c)
        self.unknown: UnknownPayload = unknown_payload(c)
        self.encoders: EncoderLimits = encoder_limits(c, c.loop.rate_Hz)
        self.static_N = static_N(c, self.model)
        self.weight_N, self.peak_N = float(np.abs(w.rest).max()), float(np.abs(w.tau).max())
        self.fastest_m_s = float(np.abs(w.dq).max())
        self.own_step_N = float(np.abs(w.steps()[1]).max())
        self.stroke_m = c.platform.length_max_m - c.platform.length_min_m
        self.force_step_N, self.stepped_error_m = float(force_steps_N(c).max()), stepped_error_m(c)
        self.silence = reacted_to(c, w) if self.protocol.traits.has_watchdog else None
        model = None if c.plant is None else c.plant.model
        self.stewart = model if isinstance(model, StewartPlant) else None
        self.learned: Learned | None = learned(c, self.unknown.mobility[0])
        self.slowed: SpeedChange | None = None
        self.jogged: JogDemand | None = None
        self.setpoints: tuple[float, float] | None = None
        if isinstance(c.reference, LiveReference):
            self.setpoints = setpoint_peaks(c, c.reference, self.model)
        else:
            self.slowed = speed_change(c, w, self.trajectory, self.model, self.span_s)
            self.jogged = jog_demand(c, self.trajectory, self.model, self.span_s)
        law = c.controller
        self.variant = "" if law.axes is None or law.believed is None else law.believed.variant
        dynamics = law.error_dynamics()
        self.dynamics = dynamics if isinstance(dynamics, ErrorDynamics) else None
        self.delay = loop_delay(c)
        if isinstance(model, BenchPlant):
            self.leg_mass_kg = model.mass_kg
        else:
            rotor_kg = 0.0 if law.believed is None else float(np.max(law.believed.reflected_mass_kg))
            mobility = np.diagonal(self.unknown.mobility, axis1=1, axis2=2)
            self.leg_mass_kg = float(1.0 / mobility.min()) + rotor_kg

    @property
    def switches(self) -> bool:
        """True if the control law switches between two forces without a boundary layer."""
        return self.dynamics is not None and bool(np.isinf(self.dynamics.K_D.max()))

    @property
    def margin(self) -> dict[str, float] | None:
        """Phase margin of the law, and its loss by delay and wrench observer; None if unknown."""
        if self.dynamics is None or self.switches:
            return None
        K_P, K_D, delay_s = float(self.dynamics.K_P.max()), float(self.dynamics.K_D.max()), self.delay.total_s
        whole, left = phase_margin_deg(K_P, K_D), phase_margin_deg(K_P, K_D, delay_s)
        crossover, observer = cross_over(K_P, K_D), observer_of(self.c)
        if observer is not None:
            law = observed(gains(K_P, K_D, self.period_s), observer)
            found = analyse(Axis(*self.delay), law).margins
            crossover, left = (crossover, 0.0) if found is None else (found.crossover_rad_s, found.phase_deg)
        return {
            "cross_over_rad_s": crossover,
            "delay_ms": 1e3 * delay_s,
            "phase_loss_deg": whole - left,
            "phase_margin_deg": left,
        }

    @cached_property
    def designed(self) -> LoopFinding | None:
        """Margins of a designed controller (`state_space`) with the loop's delay; None for another law."""
        law = self.c.controller
        controller = controller_of(law, self.c.folder)
        if controller is None or not isinstance(law, StateSpaceSettings):
            return None
        return designed_loop(law.controller_file, controller, self.delay, observer_of(self.c))

    @cached_property
    def answers_us(self) -> list[float]:
        """Bus time, us, of SYNC or polls and the feedback frames, one value for each bus."""
        return [1e-3 * ns for ns in answered_ns(self.c)]


def looked_at(c: Configuration, tell: Callable[[float, float], None] = lambda *_: None) -> Subject:
    """Data of `hil check` for a configuration. Raises ConfigurationError as `course`."""
    return Subject(c, tell, *course(c))


def controlled_stop_m(c: Configuration, w: Walk) -> float:
    """Longest travel of a leg in a controlled stop, m: path time advances by half of `engage.stop_s`."""
    return 0.5 * c.engage.stop_s * float(np.abs(w.dq).max())


def reacted_to(c: Configuration, w: Walk) -> Silence:
    """Travel of the legs after commands are lost, with a reaction within drives.watchdog_ms."""
    home, still = pose_arrays(c.platform.home), np.zeros(6)
    a = float(np.abs(w.ddq).max())
    for corner in corners(c.platform):
        platform = build_platform(corner.settings)
        model = Model(platform, leg_spin=c.platform.leg_spin)
        falls = jacobian(platform, *home) @ model.forward_dynamics(*home, still, still)
        a = max(a, float(np.abs(falls).max()))
    return Silence(1e-3 * c.drives.watchdog_ms + c.engage.closing_s, a)


def setpoint_peaks(c: Configuration, reference: LiveReference, model: Model) -> tuple[float, float]:
    """Peak rate, m/s, and acceleration, m/s^2, of a leg near the start, with all axes at their limits."""
    chi = pose_coordinates(reference.start or c.platform.home)
    legs = np.abs(jacobian(model.platform, chi[:3], rotation_from_vector(chi[3:])))
    fastest, hardest = (float((legs @ words).max()) for words in axis_limits(reference.limits)[:2])
    return fastest, hardest


def carried(s: Subject) -> list[tuple[Array, Walk]]:
    """Static forces (6,) N and motion along the reference, for each corner of the payload's ranges.

    Empty without ranges. Raises ConfigurationError with the limits that a payload violates.
    """
    c, found = s.c, []
    by_limit: dict[str, list[tuple[Violation, str]]] = {}
    for corner in corners(c.platform)[1:]:
        platform = build_platform(corner.settings)
        model = Model(platform, leg_spin=c.platform.leg_spin)
        w = walk(platform, model, s.trajectory, s.span_s, s.period_s, c.plant)
        for violation in violations(w, c.platform, c.limits, s.period_s):
            by_limit.setdefault(violation.limit, []).append((violation, corner.words))
        found.append((static_N(c, model), w))
    if by_limit:
        raise refused(c, *map(_violated, by_limit.values()), path=("platform", "platform", "payload"))
    return found


def _violated(found: list[tuple[Violation, str]]) -> str:
    """Message about one limit that payloads violate, with the earliest violation."""
    first, words = min(found)
    more = f" and {len(found) - 1} other corners of the ranges" if len(found) > 1 else ""
    return (
        f"with {words}{more}, at t = {first.t:.3f} s: {first.message}; narrow mass_range_kg or "
        "com_range_m, use a gentler reference, or raise the limit if legs and drives allow it"
    )
