"""The law's mathematics in plain NumPy: what the compiled kernels are compared with.

Legs do not spin about their axes here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.robot.geometry import Platform

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class PlainRobot:
    """Constants of one robot, named as in the equations."""

    a: Array
    """(6, 3) m, base joints in the base frame."""
    b: Array
    """(6, 3) m, platform joints in the platform frame."""
    g: Array
    """(3,) m/s^2."""
    m: float
    com: Array
    """(3,) m, platform frame."""
    inertia: Array
    """(3, 3) kg m^2, about the platform's origin, platform axes."""
    m1: float
    c1: float
    m2: float
    c2: float
    transverse: float
    """kg m^2, cylinder and rod, each about its own centre of mass."""

    @classmethod
    def of(cls, platform: Platform) -> PlainRobot:
        """Take the constants of a platform."""
        body, cylinder, rod = platform.platform, platform.cylinder, platform.rod
        x = body.com
        return cls(
            a=platform.base_joints,
            b=platform.platform_joints,
            g=platform.gravity,
            m=body.mass,
            com=x,
            inertia=body.inertia + body.mass * ((x @ x) * np.eye(3) - np.outer(x, x)),
            m1=cylinder.mass,
            c1=cylinder.com,
            m2=rod.mass,
            c2=rod.com,
            transverse=cylinder.inertia_transverse + rod.inertia_transverse,
        )


class PlainPose(NamedTuple):
    """Pose, twist and Jacobian of one tick."""

    p: Array
    R: Array
    twist: Array
    J: Array


_NEXT, _AFTER = [1, 2, 0], [2, 0, 1]


def cross(u: Array, v: Array) -> Array:
    """Return u x v over the last axis; five times as fast as numpy.cross."""
    result: Array = u[..., _NEXT] * v[..., _AFTER] - u[..., _AFTER] * v[..., _NEXT]
    return result


def legs(robot: PlainRobot, p: Array, R: Array) -> tuple[Array, Array, Array]:
    """Return lengths l (6,), unit vectors s (6, 3) from base to platform joint, and r_i = R b_i (6, 3)."""
    r = robot.b @ R.T
    d = p + r - robot.a
    l = np.sqrt((d * d).sum(axis=1))
    return l, d / l[:, None], r


def cayley(w: Array) -> Array:
    """Return C(w) = I + 2/(1 + a.a) ([a]x + [a]x^2), a = w/2."""
    x, y, z = w / 2
    A = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    C: Array = np.eye(3) + 2.0 / (1.0 + x * x + y * y + z * z) * (A + A @ A)
    return C


def forward_kinematics(
    robot: PlainRobot, q: Array, dq: Array, p: Array, R: Array, tolerance: float = 1e-10
) -> PlainPose:
    """Find the pose with lengths q near p, R by Newton's method, and its twist J^-1 dq.

    J step = q - l, p += step_v, R = C(step_w) R; row i of J is [s_i, r_i x s_i]. numpy raises LinAlgError
    where J is singular.
    """
    for _ in range(12):
        l, s, r = legs(robot, p, R)
        J = np.hstack((s, cross(r, s)))
        error = q - l
        if np.abs(error).max() <= tolerance:
            break
        step: Array = np.linalg.solve(J, error)
        p = p + step[:3]
        R = cayley(step[3:]) @ R
    twist: Array = np.linalg.solve(J, dq)
    return PlainPose(p, R, twist, J)


def joint_inverse_dynamics(robot: PlainRobot, pose: PlainPose, ddq: Array) -> Array:
    """Return tau = J^-T [M J^-1 (ddq - (dJ/dt) twist) + H + G], (6,) N, by Newton-Euler.

    Each leg needs the force M_i du_i + h_i + g_i at its platform joint, with
    M_i = m2 s s^T + I/l^2 (1 - s s^T), I = I1 + I2 + m1 c1^2 + m2 (l - c2)^2,
    h_i = m2 c2 |ds|^2 s + 2 dl/l (m2 (l - c2) - I/l) ds,
    g_i = -m2 s s.g - (m1 c1 + m2 (l - c2))/l (g - s s.g).
    """
    R, J = pose.R, pose.J
    v, w = pose.twist[:3], pose.twist[3:]
    l, s, r = legs(robot, pose.p, R)
    g, m1, c1, m2, c2 = robot.g, robot.m1, robot.c1, robot.m2, robot.c2

    u = v + cross(w, r)
    dl = (s * u).sum(axis=1)
    ds = (u - s * dl[:, None]) / l[:, None]
    centripetal = cross(w, cross(w, r))
    Jdot_twist = (ds * u).sum(axis=1) + (s * centripetal).sum(axis=1)
    dtwist = np.linalg.solve(J, ddq - Jdot_twist)
    dv, dw = dtwist[:3], dtwist[3:]

    inertia = robot.transverse + m1 * c1**2 + m2 * (l - c2) ** 2
    du = dv + cross(dw, r) + centripetal
    across = (inertia / l**2)[:, None]
    along = (m2 - across) * (s * du).sum(axis=1)[:, None]
    M_du = across * du + along * s
    h = (m2 * c2 * (ds * ds).sum(axis=1))[:, None] * s
    h = h + (2.0 * dl / l * (m2 * (l - c2) - inertia / l))[:, None] * ds
    sg = (s @ g)[:, None]
    weight = -m2 * sg * s - ((m1 * c1 + m2 * (l - c2)) / l)[:, None] * (g - sg * s)
    at_joint = M_du + h + weight

    x = R @ robot.com
    lift = robot.m * (dv - g)
    force = lift + robot.m * (cross(dw, x) + cross(w, cross(w, x)))
    wp = R.T @ w
    turning = robot.inertia @ (R.T @ dw) + cross(wp, robot.inertia @ wp)
    moment = R @ turning + cross(x, lift)
    f = np.concatenate((force + at_joint.sum(axis=0), moment + cross(r, at_joint).sum(axis=0)))
    tau: Array = np.linalg.solve(J.T, f)
    return tau
