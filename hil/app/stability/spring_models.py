"""Assessment of laws that do not linearise the robot: PD on legs and on the pose, PID, feed-forward.

What is proven of these laws is proven of a reference at rest; of a moving one nothing is, and the claim
says so.
"""

from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.errors import ModelError
from hil.app.stability.first_order import (
    Forces,
    LegSettings,
    cartesian_forces,
    leg_forces,
    linear_at,
    loop_at_rest,
    of_first_order,
)
from hil.app.stability.spring_loop import at_rest, inertia, sampled_loop, unstable
from hil.app.stability.subject import Subject
from hil.config.model import ModelSettings
from hil.control.cartesian_pd import CartesianPDSettings
from hil.control.feedforward_pd import FeedforwardPDSettings
from hil.control.law import per_leg
from hil.control.pd import PDSettings
from hil.control.pd_gravity import PDGravitySettings
from hil.control.pid import PIDSettings
from hil.design.stability.assessment import Assessment
from hil.design.stability.coupled import integrating, proportional
from hil.design.stability.energy import (
    Potential,
    Well,
    basin,
    leg_springs,
    stiffness_matrix,
    total,
    weight,
    well,
)
from hil.mathematics.rotations import relative_rotation
from hil.robot import dynamics_kernels as kernels
from hil.robot.dynamics import Model
from hil.robot.kinematics import leg_lengths
from plant_fmu.config import BenchPlant

_STILL = np.zeros(6)
AT_ONCE = (
    "forces answer at once: V knows no sampling, delay or lag; what these do to small errors where "
    "it comes to rest is in the sampled loop"
)


FROZEN = "a weight that is frozen while the robot moves has no potential"


class Held(NamedTuple):
    """A law at the reference's start, at rest."""

    S: Potential
    exact: bool
    """Whether dS vanishes at the set-point alone: exact compensation of the weight."""
    forces: Forces
    damping: str
    """By which V falls."""
    stiffness: float | None = None
    """N/m, of all legs' springs together where S is theirs alone: the level is a length."""


def legs(subject: Subject, law: LegSettings, *, quick: bool) -> Assessment:
    """Judge a PD on leg lengths by its energy."""
    p, R = subject.path[0].p, subject.path[0].R
    q = leg_lengths(subject.platform, p, R)
    K_p = per_leg(law.kp_N_m)
    compensated = None
    tau = _STILL
    if isinstance(law, PDGravitySettings) and law.model.variant == "constant_MG":
        return of_first_order(subject, leg_forces(subject, law), FROZEN)
    if isinstance(law, FeedforwardPDSettings) or (
        isinstance(law, PDGravitySettings) and law.model.variant == "constant"
    ):  # the same forces wherever the robot is
        tau = subject.believed(law.model).inverse_dynamics(p, R, _STILL, _STILL)
    elif isinstance(law, PDGravitySettings):
        compensated = _weighing(subject, law.model)
    S = total(leg_springs(subject.platform, q, K_p, tau), weight(subject.robot, compensated))
    exact = compensated is not None and _same_weight(subject, compensated)
    stiffness = float(K_p.sum()) if exact else None
    held = Held(S, exact, leg_forces(subject, law), "dq^T K_v dq", stiffness)
    found = _judge(subject, held, quick=quick)
    estimated = isinstance(law, FeedforwardPDSettings) and law.evaluation == "online"
    more = subject.wrench if estimated and found.status != "unstable" else []
    return found._replace(conditions=found.conditions + more)


def cartesian(subject: Subject, law: CartesianPDSettings, *, quick: bool) -> Assessment:
    """Judge a PD on the pose by its energy, where it has one."""
    p, R = subject.path[0].p, subject.path[0].R
    K_p, _ = law.gains()
    reason = _without_energy(law, K_p)
    if reason is not None:
        return of_first_order(subject, cartesian_forces(subject, law), reason)
    compensated = None if law.model is None else _weighing(subject, law.model)

    def springs(at_p: Array, at_R: Array) -> float:
        r = relative_rotation(at_R, R)
        e = p - at_p
        return float(0.5 * e @ (K_p[:3] * e) + 0.5 * K_p[3] * r @ r)

    S = total(springs, weight(subject.robot, compensated))
    exact = compensated is not None and _same_weight(subject, compensated)
    return _judge(subject, Held(S, exact, cartesian_forces(subject, law), "t^T K_v t"), quick=quick)


def _without_energy(law: CartesianPDSettings, K_p: Array) -> str | None:
    """Say why a PD on the pose has no energy function; None where it has one."""
    if law.rotation_error == "vector_difference":
        return "the stiffness of vector_difference is not symmetric"
    if law.model is not None and law.model.variant in {"constant", "constant_MG"}:
        return FROZEN
    return (
        "three stiffnesses of rotation have an energy to first order only" if len(set(K_p[3:])) > 1 else None
    )


def pid(subject: Subject, law: PIDSettings) -> Assessment:
    """Judge a PID by its eigenvalues at the reference's start (Lyapunov's indirect method)."""
    p, R = subject.path[0].p, subject.path[0].R
    K_p, K_v, K_i = (per_leg(gain) for gain in (law.kp_N_m, law.kv_N_s_m, law.ki_N_m_s))
    J, mobility = inertia(subject, p, R)
    tau = subject.robot.inverse_dynamics(p, R, _STILL, _STILL)
    q = leg_lengths(subject.platform, p, R)
    own = stiffness_matrix(total(leg_springs(subject.platform, q, _STILL, tau), weight(subject.robot)), p, R)
    nothing, unit = np.zeros((6, 6)), np.eye(6)
    A = np.block(
        [
            [nothing, unit, nothing],
            [
                -mobility @ (own + J.T @ (K_p[:, None] * J)),
                -mobility @ J.T @ (K_v[:, None] * J),
                mobility @ J.T,
            ],
            [-K_i[:, None] * J, nothing, nothing],
        ]
    )
    slowest = float(np.linalg.eigvals(A).real.max())
    controller = integrating(K_p, K_v, K_i, subject.axis.period_s)
    of_legs = np.linalg.solve(J.T, own) @ np.linalg.inv(J)
    lines, figures, radius = sampled_loop(
        subject, controller, J @ mobility @ J.T, of_legs, "at the reference's start"
    )
    lines.insert(0, f"eigenvalues    slowest exp({slowest:+.3g} t) of 18, the weight's stiffness included")
    figures["slowest_eigenvalue_1_s"] = slowest
    short = float((np.abs(tau) / per_leg(law.integral_limit_N)).max())
    if slowest >= 0.0 or radius >= 1.0:
        claim = unstable(subject, radius) if radius >= 1.0 else f"an eigenvalue grows as exp({slowest:.3g} t)"
        return Assessment("unstable", claim, [], lines, figures)
    if short > 1.0:
        claim = f"the integral cannot carry the weight: {100 * short:.0f} % of integral_limit_N"
        return Assessment("not proven", claim, at_rest(subject), lines, figures)
    rate = -np.log(radius) / subject.axis.period_s
    claim = f"at the reference's start small errors die out as exp(-{rate:.3g} t)"
    return Assessment("conditional", claim, [*at_rest(subject), "errors are small"], lines, figures)


def bench(subject: Subject, law: PDSettings, plant: BenchPlant) -> Assessment:
    """Judge a PD on six uncoupled legs with springs and dampers of their own."""
    K_p = per_leg(law.kp_N_m)
    controller = proportional(K_p, per_leg(law.kv_N_s_m), subject.axis.period_s)
    q = leg_lengths(subject.platform, subject.path[0].p, subject.path[0].R)
    x = _bench_rest(q - plant.rest_length_m, K_p, plant)
    springs = np.diag(plant.stiffness_N_m + 3.0 * plant.stiffness_N_m3 * x * x)
    lines, figures, radius = sampled_loop(
        subject, controller, np.eye(6) / plant.mass_kg, springs, "where it comes to rest"
    )
    if radius >= 1.0:
        return Assessment("unstable", unstable(subject, radius), [], lines, figures)
    conditions = [*at_rest(subject), AT_ONCE]
    claim = (
        "each leg's V = m dq^2 / 2 + K_p e^2 / 2 + its own springs falls by K_v dq^2 + b |dq|^3 and grows "
        "without bound: its rest is globally asymptotically stable (LaSalle)"
    )
    return Assessment("conditional", claim, conditions, lines, figures)


def _bench_rest(x_d: Array, K_p: Array, plant: BenchPlant) -> Array:
    """Return where legs (6,) m come to rest, k0 x + k1 x^3 = K_p (x_d - x), from their springs' rest."""
    low, high = np.minimum(x_d, 0.0), np.maximum(x_d, 0.0)
    for _ in range(60):
        x = 0.5 * (low + high)
        pulled = plant.stiffness_N_m * x + plant.stiffness_N_m3 * x**3 > K_p * (x_d - x)
        low, high = np.where(pulled, low, x), np.where(pulled, x, high)
    return np.asarray(0.5 * (low + high), np.float64)


def _judge(subject: Subject, held: Held, *, quick: bool) -> Assessment:
    s = subject.path[0]
    conditions = [*at_rest(subject), AT_ONCE]
    try:
        rest = well(held.S, s.p, s.R, subject.platform.radius)
    except ModelError as error:
        return Assessment("not proven", str(error), conditions, [], {})
    sag = leg_lengths(subject.platform, rest.p, rest.R) - leg_lengths(subject.platform, s.p, s.R)
    sag_mm = 1e3 * float(np.abs(sag).max())
    energy = {"stiffness_N_m": rest.stiffness.tolist(), "sag_mm": sag_mm}
    line = f"stiffness      {rest.stiffness[0]:.4g} to {rest.stiffness[-1]:.4g} N/m where it comes to rest"
    claim = None
    if not rest.stable:
        claim = "the weight is stiffer than the springs: it falls over"
    elif (met := subject.outside(rest.p, rest.R)) is not None:
        claim = f"it comes to rest outside its limits: {met}"
    if claim is not None:
        return Assessment("not proven", claim, conditions, [line], {"energy": energy})
    lines, figures, radius = loop_at_rest(subject, linear_at(subject, held.forces, rest.p, rest.R))
    lines, figures = [line, *lines], figures | {"energy": energy}
    if radius >= 1.0:
        return Assessment("unstable", unstable(subject, radius), [], lines, figures)
    if not quick:
        _basin(subject, held, rest, lines, figures)
    near = held.exact or sag_mm < 1e-3
    where = "the set-point" if near else f"a pose {sag_mm:.3g} mm of leg length off the set-point"
    claim = f"V = t^T M t / 2 + S falls by {held.damping}: {where} is asymptotically stable (LaSalle)"
    if not held.exact:
        conditions.append("no other equilibrium lies in the sublevel set: not searched for")
    return Assessment("conditional", claim, conditions, lines, figures)


def _basin(subject: Subject, held: Held, rest: Well, lines: list[str], figures: dict[str, Any]) -> None:
    found = basin(held.S, rest, subject.platform.radius, subject.outside)
    start_mm = None if held.stiffness is None else 1e3 * float(np.sqrt(2.0 * found.level_J / held.stiffness))
    starts = (
        ""
        if start_mm is None
        else f": every start at rest with all legs up to {start_mm:.3g} mm off, in this assembly"
    )
    lines.append(
        f"sublevel set   V < {found.level_J:.4g} J stays within stroke and regular J (by search; its edge: "
        f"{found.reason}){starts}"
    )
    figures["energy"] |= {
        "level_J": found.level_J,
        "edge": found.reason,
        "edge_position_m": found.edge_p.tolist(),
        "start_mm": start_mm,
    }


def _weighing(subject: Subject, settings: ModelSettings) -> Model:
    """Return what a law believes that compensates the weight where the robot is: no frozen variant."""
    variant = "massless_legs" if settings.variant == "massless_legs" else "full"
    return subject.believed(settings.model_copy(update={"variant": variant, "frozen_at": None}))


def _same_weight(subject: Subject, believed: Model) -> bool:
    """Tell whether two models weigh the same wherever the robot is, however it is turned."""
    return bool(np.allclose(_moments(believed), _moments(subject.robot), rtol=1e-9, atol=1e-9))


def _moments(model: Model) -> Array:
    """Return what weight and its potential are made of beside the place, N and N m."""
    c = model.constants
    mass, cylinder, rod = c[kernels.MASS], c[kernels.CYLINDER_MASS], c[kernels.ROD_MASS]
    along = cylinder * c[kernels.CYLINDER_COM] - rod * c[kernels.ROD_COM]
    parts = np.array([mass, *(mass * c[kernels.COM : kernels.COM + 3]), rod, along])
    return np.asarray(np.linalg.norm(c[kernels.GRAVITY : kernels.GRAVITY + 3]) * parts, np.float64)
