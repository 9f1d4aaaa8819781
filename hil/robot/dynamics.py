"""The controller's model of the robot: M dtwist + H + G = J^T (tau - friction) + wrench, and simplifications.

This module packs constants and checks arguments. The equations are in ``hil.robot.dynamics_kernels``; the
control loop calls the kernels directly.
"""

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from drivers.arrays import Array
from drivers.errors import ModelError
from hil.mathematics.linear_algebra import condition_kernel
from hil.robot import dynamics_kernels as kernels
from hil.robot.geometry import GeometryError, Platform
from hil.robot.kinematics import SINGULAR, KinematicsError, check_rotation, check_vector
from hil.robot.kinematics_kernels import jacobian_kernel

Variant = Literal["full", "no_H", "printed", "constant", "constant_MG", "massless_legs"]
LegSpin = Literal["none", "universal"]

SLIDING_SPEED = 1e-3
"""Default leg rate, m/s, above which Coulomb friction acts in full: well above its noise at rest."""

CODES: dict[str, int] = {
    "full": kernels.FULL,
    "no_H": kernels.NO_H,
    "printed": kernels.PRINTED,
    "constant": kernels.CONSTANT,
    "constant_MG": kernels.CONSTANT_MG,
    "massless_legs": kernels.FULL,
}


class Model:
    """Rigid-body model of the platform and its legs, with reflected mass and friction of the drives.

    ============= ============================================================================================
    full          M dtwist + H + G, legs included
    no_H          without the centripetal and gyroscopic forces H
    printed       without H and, in the joint-space law, without (dJ/dt) twist: the equation as often printed
    constant      M, G and J frozen at ``frozen_at``, no H, no (dJ/dt) twist (Lee et al., 2003): small motion
    constant_MG   M and G frozen, no H, no (dJ/dt) twist; J current
    massless_legs full, with massless legs
    ============= ============================================================================================

    Every variant contains the drives. The reflected mass m_r adds J^T diag(m_r) J to M (frozen with M) and
    J^T diag(m_r) (dJ/dt) twist to H (omitted with H). Along the legs it needs the force m_r ddq (Siciliano,
    Sciavicco, Villani and Oriolo, Robotics, 2009, ch. 7: motor inertia times gear ratio squared). Friction is
    a separate leg force, ``friction``, at the leg rates dq = J twist with the current J.

    Parameters
    ----------
    platform : Platform
    variant : one of the above
    leg_spin : ``none``: a leg never turns about its own axis; ``universal``: its universal joint imposes
        the turn, with hinges ``platform.universal_joint_base_axes``.
    frozen_at : (p, R), the pose of the constant variants.
    inertia_scale : factor on all masses (reflected ones included), all inertias and the platform's centre of
        mass. The centres of mass along the legs stay exact, as do joints, lengths, J, its rate, gravity and
        friction.
    reflected_mass : (6,) kg, or one number for all legs. Inertia of motor and screw as a mass along the leg:
        rotary inertia times (2 pi / lead)^2, without weight.
    viscous : (6,) N s/m, or one number for all legs.
    coulomb : (6,) N, or one number for all legs.
    sliding_speed : m/s, leg rate above which Coulomb friction acts in full. Below, it grows linearly
        from 0 at rest. 0: coulomb sgn(dq), sgn(0) = 0.

    Attributes
    ----------
    constants : (173,) read-only, and ``code``: int
        The first two arguments of the kernels.

    Raises ModelError for an unknown variant, a constant variant without pose, missing hinge axes, or a
    parameter that is negative or not finite.

    Notes
    -----
    Arguments of the methods, all in the base frame: p (3,) m, platform origin; R (3, 3), x_base = p + R
    x_platform; twist (6,) m/s and rad/s, [v of the platform origin; omega], and its derivative dtwist; tau
    (6,) N, leg forces, > 0 extends; wrench (6,) N and N m, force and moment ON the platform at its origin, by
    default zero. All methods raise KinematicsError for an argument that is not finite or an R that is not a
    rotation.
    """

    def __init__(
        self,
        platform: Platform,
        variant: Variant = "full",
        leg_spin: LegSpin = "none",
        *,
        frozen_at: tuple[ArrayLike, ArrayLike] | None = None,
        inertia_scale: float = 1.0,
        reflected_mass: ArrayLike = 0.0,
        viscous: ArrayLike = 0.0,
        coulomb: ArrayLike = 0.0,
        sliding_speed: float = SLIDING_SPEED,
    ) -> None:
        if variant not in CODES:
            raise ModelError(f"model variant: got {variant!r}, allowed are {', '.join(CODES)}")
        if leg_spin not in get_args(LegSpin):
            raise ModelError(f"leg_spin: got {leg_spin!r}, allowed are {', '.join(get_args(LegSpin))}")
        if leg_spin == "universal" and platform.universal_joint_base_axes is None:
            raise GeometryError(
                "universal_joint_base_axes", "nothing", "six directions, because leg_spin is universal"
            )
        if not (np.isfinite(inertia_scale) and inertia_scale > 0):
            raise ModelError(f"inertia_scale: got {inertia_scale}, allowed is a finite number > 0")
        self.platform = platform
        self.variant = variant
        self.leg_spin = leg_spin
        self.code = CODES[variant]
        constants = pack_constants(
            platform, inertia_scale, spin=leg_spin == "universal", massless_legs=variant == "massless_legs"
        )
        reflected = inertia_scale * _not_negative("reflected_mass", "kg", reflected_mass)
        constants[kernels.REFLECTED : kernels.REFLECTED + 6] = reflected
        constants[kernels.VISCOUS : kernels.VISCOUS + 6] = _not_negative("viscous", "N s/m", viscous)
        constants[kernels.COULOMB : kernels.COULOMB + 6] = _not_negative("coulomb", "N", coulomb)
        constants[kernels.SLIDING_SPEED] = _not_negative("sliding_speed", "m/s", sliding_speed, ())
        if variant in ("constant", "constant_MG"):
            if frozen_at is None:
                raise ModelError(
                    f"model variant {variant!r} needs frozen_at, the pose where M and G are taken"
                )
            self._freeze(constants, check_vector("p", frozen_at[0], 3), check_rotation(frozen_at[1]))
        constants.flags.writeable = False
        self.constants = constants

    @staticmethod
    def _freeze(c: Array, p: Array, R: Array) -> None:
        a = c[kernels.BASE : kernels.BASE + 18].reshape(6, 3)
        b = c[kernels.PLATFORM : kernels.PLATFORM + 18].reshape(6, 3)
        J = jacobian_kernel(a, b, p, R)
        c[kernels.FROZEN_M : kernels.FROZEN_M + 36] = kernels.mass_matrix_kernel(c, p, R).ravel()
        c[kernels.FROZEN_G : kernels.FROZEN_G + 6] = kernels.gravity_kernel(c, p, R)
        c[kernels.FROZEN_J : kernels.FROZEN_J + 36] = J.ravel()

    def inverse_dynamics(
        self, p: ArrayLike, R: ArrayLike, twist: ArrayLike, dtwist: ArrayLike, wrench: ArrayLike | None = None
    ) -> Array:
        """Leg forces (6,) N for a motion: tau = J^-T (M dtwist + H + G - wrench) + friction(J twist).

        Raises KinematicsError also at a pose with singular J.
        """
        p, R, twist = self._state(p, R, twist)
        dtwist = check_vector("dtwist", dtwist, 6)
        tau = kernels.inverse_dynamics_kernel(self.constants, self.code, p, R, twist, dtwist, _wrench(wrench))
        self._refuse_singular(p, R)
        return _finite("tau", tau, p, R)

    def forward_dynamics(
        self, p: ArrayLike, R: ArrayLike, twist: ArrayLike, tau: ArrayLike, wrench: ArrayLike | None = None
    ) -> Array:
        """Acceleration (6,) m/s^2, rad/s^2: dtwist = M^-1 (J^T (tau - friction(J twist)) + wrench - H - G).

        tau: leg forces (6,) N. Coulomb friction has no stiction: at rest sgn(0) = 0, and the legs slide.
        """
        p, R, twist = self._state(p, R, twist)
        tau = check_vector("tau", tau, 6)
        dtwist = kernels.forward_dynamics_kernel(self.constants, self.code, p, R, twist, tau, _wrench(wrench))
        return _finite("dtwist", dtwist, p, R)

    def mass_matrix(self, p: ArrayLike, R: ArrayLike) -> Array:
        """Mass matrix M (6, 6) of platform, legs and drives in twist coordinates: kg, kg m, kg m^2.

        M = platform + sum J_i^T M_i J_i (Taghirad, 2013, 5.3) + J^T diag(reflected_mass) J. Evaluated at p, R
        in every variant.
        """
        p, R = check_vector("p", p, 3), check_rotation(R)
        return _finite("M", kernels.mass_matrix_kernel(self.constants, p, R), p, R)

    def coriolis(self, p: ArrayLike, R: ArrayLike, twist: ArrayLike) -> Array:
        """Centripetal and gyroscopic forces H (6,): N, N m. Evaluated at p, R, twist in every variant.

        Includes J^T diag(reflected_mass) (dJ/dt) twist; excludes friction.
        """
        p, R, twist = self._state(p, R, twist)
        return _finite("H", kernels.coriolis_kernel(self.constants, p, R, twist), p, R)

    def gravity(self, p: ArrayLike, R: ArrayLike) -> Array:
        """Forces G (6,) N, N m, base frame, that carry platform and legs against gravity at the pose p, R."""
        p, R = check_vector("p", p, 3), check_rotation(R)
        return _finite("G", kernels.gravity_kernel(self.constants, p, R), p, R)

    def friction(self, dq: ArrayLike) -> Array:
        """Drive friction (6,) N at leg rates dq (6,) m/s, with the signs of dq.

        viscous dq + coulomb sat(dq / sliding_speed); Siciliano et al., Robotics, 2009, ch. 7: F_v dq + F_s
        sgn(dq), here with a slope for the jump at rest. sat(x) is x clamped to -1 .. 1; with
        ``sliding_speed`` 0 it is sgn, sgn(0) = 0. The force on a leg is tau - friction.
        """
        return kernels.friction_kernel(self.constants, check_vector("dq", dq, 6))

    def kinetic_energy(self, p: ArrayLike, R: ArrayLike, twist: ArrayLike) -> float:
        """Kinetic energy, J, of platform, legs and drives: twist^T M twist / 2."""
        p, R, twist = self._state(p, R, twist)
        return float(0.5 * twist @ self.mass_matrix(p, R) @ twist)

    def potential_energy(self, p: ArrayLike, R: ArrayLike) -> float:
        """Potential energy, J, of platform and legs in gravity: -sum m g.x, zero at the base origin."""
        return kernels.potential_energy_kernel(self.constants, check_vector("p", p, 3), check_rotation(R))

    @staticmethod
    def _state(p: ArrayLike, R: ArrayLike, twist: ArrayLike) -> tuple[Array, Array, Array]:
        return check_vector("p", p, 3), check_rotation(R), check_vector("twist", twist, 6)

    def _refuse_singular(self, p: Array, R: Array) -> None:
        J = jacobian_kernel(self.platform.base_joints, self.platform.platform_joints, p, R)
        bound = condition_kernel(J, self.platform.radius)
        if not bound < SINGULAR:
            raise KinematicsError(
                f"singular pose p = {p.tolist()} m, R = {R.tolist()}: condition number of J {bound:.3g} "
                f"(limit {SINGULAR:.0e}), leg forces cannot carry every load",
                p=p,
                R=R,
                condition=bound,
            )


def pack_constants(
    platform: Platform, inertia_scale: float = 1.0, *, spin: bool = False, massless_legs: bool = False
) -> Array:
    """Geometry and inertia as the vector (173,) of the dynamics kernels; frozen and drive entries are 0."""
    k = inertia_scale
    c = np.zeros(kernels.SIZE)
    m = k * platform.platform.mass
    x = k * platform.platform.com
    square = x[0] * x[0] + x[1] * x[1] + x[2] * x[2]  # no dot product: BLAS rounds it by CPU
    inertia = k * platform.platform.inertia + m * (square * np.eye(3) - np.outer(x, x))
    c[kernels.BASE : kernels.BASE + 18] = platform.base_joints.ravel()
    c[kernels.PLATFORM : kernels.PLATFORM + 18] = platform.platform_joints.ravel()
    if platform.universal_joint_base_axes is not None:
        c[kernels.AXES : kernels.AXES + 18] = platform.universal_joint_base_axes.ravel()
    c[kernels.MASS] = m
    c[kernels.COM : kernels.COM + 3] = x
    c[kernels.INERTIA : kernels.INERTIA + 9] = inertia.ravel()
    c[kernels.GRAVITY : kernels.GRAVITY + 3] = platform.gravity
    if not massless_legs:
        cylinder, rod = platform.cylinder, platform.rod
        c[kernels.CYLINDER_MASS] = k * cylinder.mass
        c[kernels.CYLINDER_COM] = cylinder.com
        c[kernels.ROD_MASS] = k * rod.mass
        c[kernels.ROD_COM] = rod.com
        c[kernels.TRANSVERSE] = k * (cylinder.inertia_transverse + rod.inertia_transverse)
        if spin:
            c[kernels.AXIAL] = k * (cylinder.inertia_axial + rod.inertia_axial)
    return c


def _not_negative(name: str, unit: str, value: ArrayLike, shape: tuple[int, ...] = (6,)) -> Array:
    try:
        x = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        x = np.array(np.nan)
    if x.shape not in ((), shape) or not (np.isfinite(x) & (x >= 0)).all():
        allowed = "a finite number >= 0" + (" for all legs, or six of them" if shape else "")
        raise ModelError(f"{name}: got {value!r} {unit}, allowed is {allowed}")
    return np.broadcast_to(x, shape)


def _wrench(wrench: ArrayLike | None) -> Array:
    return np.zeros(6) if wrench is None else check_vector("wrench", wrench, 6)


def _finite(name: str, value: Array, p: Array, R: Array) -> Array:
    if not np.isfinite(value).all():
        raise KinematicsError(
            f"{name} is undefined at p = {p.tolist()} m, R = {R.tolist()}: singular pose, a leg of "
            "length zero, or a leg along the base hinge of its universal joint",
            p=p,
            R=R,
        )
    return value
