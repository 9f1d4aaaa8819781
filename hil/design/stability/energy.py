"""Energy as a Lyapunov function: PD laws that hold a pose (Takegaki and Arimoto, 1981; LaSalle).

Springs of K_p, what the law compensates, and the robot's weight are one potential S of the pose. With the
robot's kinetic energy

::

    V = t^T M t / 2 + S,     dV/dt = -dq^T K_v dq  (friction only adds to that)

For a reference at rest a pose where dS = 0 and d^2 S is positive definite is asymptotically stable; from
every start with V < c it is reached, if c is the lowest S on the edge of a region around that pose in which J
is regular, legs are within their stroke, and no other pose has dS = 0.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.mathematics.rotations import relative_rotation, rotation_from_vector
from hil.robot import dynamics_kernels as kernels
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from hil.robot.kinematics_kernels import leg_lengths_kernel

Potential = Callable[[Array, Array], float]
"""S of p (3,) m and R (3, 3), J."""


class Basin(NamedTuple):
    """A sublevel set V < level from which the well is reached."""

    level_J: float
    edge_p: Array
    """(3,) m: where S = level on the edge of the region."""
    reason: str
    """What is met there."""


def leg_springs(platform: Platform, q_d: Array, K_p: Array, tau: Array) -> Potential:
    """Return S = e^T K_p e / 2 - tau^T q of springs (6,) N/m and constant forces (6,) N of the legs."""
    a, b = platform.base_joints, platform.platform_joints

    def S(p: Array, R: Array) -> float:
        q = leg_lengths_kernel(a, b, p, R)
        e = q_d - q
        return float(0.5 * e @ (K_p * e) - tau @ q)

    return S


def pose_springs(p_d: Array, R_d: Array, K_p: Array) -> Potential:
    """Return the energy, J, of springs K_p (6,) N/m and N m/rad to a pose, one stiffness of all rotations."""

    def S(p: Array, R: Array) -> float:
        r, e = relative_rotation(R, R_d), p_d - p
        return float(0.5 * e @ (K_p[:3] * e) + 0.5 * K_p[3] * r @ r)

    return S


def weight(robot: Model, compensated: Model | None = None) -> Potential:
    """Return what the robot weighs less what a law compensates of it, J."""

    def U(p: Array, R: Array) -> float:
        left = robot.potential_energy(p, R)
        return left if compensated is None else left - compensated.potential_energy(p, R)

    return U


def same_weight(one: Model, other: Model) -> bool:
    """Tell whether two models weigh the same wherever the robot is, however it is turned."""
    return bool(np.allclose(_moments(one), _moments(other), rtol=1e-9, atol=1e-9))


def _moments(model: Model) -> Array:
    """Return what weight and its potential are made of beside the place, N and N m."""
    c = model.constants
    mass, cylinder, rod = c[kernels.MASS], c[kernels.CYLINDER_MASS], c[kernels.ROD_MASS]
    along = cylinder * c[kernels.CYLINDER_COM] - rod * c[kernels.ROD_COM]
    parts = np.array([mass, *(mass * c[kernels.COM : kernels.COM + 3]), rod, along])
    return np.asarray(np.linalg.norm(c[kernels.GRAVITY : kernels.GRAVITY + 3]) * parts, np.float64)


def total(*parts: Potential) -> Potential:
    """Return the sum of potentials."""
    return lambda p, R: sum(part(p, R) for part in parts)


def displaced(p: Array, R: Array, x: Array) -> tuple[Array, Array]:
    """Return the pose shifted by x[:3] m and turned by the rotation vector x[3:] rad, base frame."""
    return p + x[:3], rotation_from_vector(x[3:]) @ R


def basin(
    S: Potential,
    p: Array,
    R: Array,
    stiffness: Array,
    radius: float,
    outside: Callable[[Array, Array], str | None],
    rays: int = 100,
) -> Basin:
    """Return the largest sublevel set around a minimum within a region, searched for along rays.

    stiffness: d^2 S (6, 6) there. radius: by which rotations become lengths, m. outside(p, R) says what is
    wrong with a pose, or None. Each ray goes from the minimum to the edge of the region, where S is read; the
    lowest is sought on from the five lowest rays by Powell's method. The directions are those of equal S near
    the minimum. A search, no enclosure.
    """
    scale = np.array([1.0] * 3 + [1.0 / radius] * 3)
    curved = scale[:, None] * stiffness * scale
    values, vectors = np.linalg.eigh(0.5 * (curved + curved.T))
    shape = scale[:, None] * vectors / np.sqrt(values)
    ground = S(p, R)
    longest = 2.0 * np.sqrt(values[-1])

    def edge(u: Array) -> tuple[float, Array]:
        """Return S above the well at the edge in direction u (6,), and the way there.

        Zero is no direction; a search along a line may pass it, and gets the first one there.
        """
        size = float(np.linalg.norm(u))
        way = shape @ (u / size) if size > 0.0 else shape[:, 0]
        near, far = 0.0, 0.0
        step = 0.02 / float(np.linalg.norm(way / scale))
        while outside(*displaced(p, R, far * way)) is None:
            near, far = far, far + step
            if far > 100.0 * longest:
                return np.inf, far * way
        for _ in range(20):
            middle = (near + far) / 2.0
            inside = outside(*displaced(p, R, middle * way)) is None
            near, far = (middle, far) if inside else (near, middle)
        return S(*displaced(p, R, far * way)) - ground, far * way

    from scipy.optimize import minimize  # noqa: PLC0415 - `hil check` does without

    directions = np.random.default_rng(1).standard_normal((rays, 6))
    directions = np.vstack([directions, np.eye(6), -np.eye(6)])
    heights = np.array([edge(u)[0] for u in directions])
    lowest = directions[np.argsort(heights)[:5]]
    options = {"maxfev": 300}
    found = [minimize(lambda u: edge(u)[0], u, method="Powell", options=options) for u in lowest]
    level, way = edge(min(found, key=lambda result: result.fun).x)
    met = displaced(p, R, way)
    return Basin(float(level), met[0], outside(*met) or "the edge of the region")
