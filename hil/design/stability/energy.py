"""Energy as a Lyapunov function: PD laws that hold a pose (Takegaki and Arimoto, 1981; LaSalle).

Springs and gravity together are one potential S of the pose: of the control law the springs of K_p and what
it compensates, of the robot its weight. With the robot's kinetic energy

::

    V = t^T M t / 2 + S,     dV/dt = -dq^T K_v dq  (friction only adds to that)

because t^T (M_dot t / 2 - H) = 0. V falls, or rests where dq = 0, which J regular turns into t = 0; staying
there takes dS = 0 (LaSalle). Hence, for a reference at rest:

- a pose where dS = 0 and the stiffness d^2 S is positive definite is asymptotically stable;
- from every start with V < c it is reached, if c is the lowest S on the edge of a region around that pose in
  which J is regular, legs are within their stroke, and no other pose has dS = 0.

PD with exact gravity compensation has S = e^T K_p e / 2: there dS = -J^T K_p e vanishes for e = 0 alone, in
the whole region. PD without it, or with a wrong weight, sags to where its springs carry what is left.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.errors import ModelError
from hil.mathematics.rotations import rotation_from_vector
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from hil.robot.kinematics_kernels import leg_lengths_kernel

Potential = Callable[[Array, Array], float]
"""S of p (3,) m and R (3, 3), J."""
STEP = 1e-4
"""m and rad, of the differences that derivatives are taken by."""


class Well(NamedTuple):
    """Where a law with a potential comes to rest."""

    p: Array
    """(3,) m."""
    R: Array
    """(3, 3)."""
    stiffness: Array
    """(6,) eigenvalues of d^2 S, N/m, rotations times the platform's radius; the smallest first."""

    @property
    def stable(self) -> bool:
        """Tell whether the pose is a minimum of S."""
        return bool(self.stiffness[0] > 0.0)


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


def weight(robot: Model, compensated: Model | None = None) -> Potential:
    """Return what the robot weighs less what a law compensates of it, J."""

    def U(p: Array, R: Array) -> float:
        left = robot.potential_energy(p, R)
        return left if compensated is None else left - compensated.potential_energy(p, R)

    return U


def total(*parts: Potential) -> Potential:
    """Return the sum of potentials."""
    return lambda p, R: sum(part(p, R) for part in parts)


def displaced(p: Array, R: Array, x: Array) -> tuple[Array, Array]:
    """Return the pose shifted by x[:3] m and turned by the rotation vector x[3:] rad, base frame."""
    return p + x[:3], rotation_from_vector(x[3:]) @ R


def well(S: Potential, p: Array, R: Array, radius: float) -> Well:
    """Return the pose at which dS = 0 nearest to p, R, by Newton's method.

    radius: of the platform's joints, m, by which rotations become lengths.

    Raises ModelError where there is none near.
    """
    scale = np.array([1.0] * 3 + [1.0 / radius] * 3)
    for _ in range(30):
        slope, stiffness = _derivatives(S, p, R, scale)
        step = -np.linalg.solve(stiffness, slope)
        if np.linalg.norm(step) > 0.5:
            break
        p, R = displaced(p, R, scale * step)
        if np.linalg.norm(step) < 1e-9:
            return Well(p, R, np.asarray(np.linalg.eigvalsh(stiffness), float))
    raise ModelError("the springs of the law carry what is left of the weight nowhere near: stiffen them")


def stiffness_matrix(S: Potential, p: Array, R: Array) -> Array:
    """Return d^2 S (6, 6) at a pose with dS = 0, of shifts and turns: N/m, N, N m/rad."""
    return _derivatives(S, p, R, np.ones(6))[1]


def _derivatives(S: Potential, p: Array, R: Array, scale: Array) -> tuple[Array, Array]:
    """Return dS (6,) and d^2 S (6, 6) of x / scale, by central differences."""
    steps = STEP * np.diag(scale)

    def at(x: Array) -> float:
        return S(*displaced(p, R, x))

    slope = np.array([at(x) - at(-x) for x in steps]) / (2.0 * STEP)
    stiffness = np.empty((6, 6))
    for i, x in enumerate(steps):
        for j, y in enumerate(steps[: i + 1]):
            mixed = at(x + y) - at(x - y) - at(y - x) + at(-x - y)
            stiffness[i, j] = stiffness[j, i] = mixed / (4.0 * STEP**2)
    return slope, stiffness


def basin(
    S: Potential, start: Well, radius: float, outside: Callable[[Array, Array], str | None], rays: int = 100
) -> Basin:
    """Return the largest sublevel set around a well within a region, searched for along rays.

    outside(p, R) says what is wrong with a pose, or None. Each ray goes from the well to the edge of the
    region, where S is read; the lowest is sought on from the five lowest rays by Powell's method. The
    directions are those of equal S near the well. A search, no enclosure.
    """
    scale = np.array([1.0] * 3 + [1.0 / radius] * 3)
    _, stiffness = _derivatives(S, start.p, start.R, scale)
    values, vectors = np.linalg.eigh(stiffness)
    shape = scale[:, None] * vectors / np.sqrt(values)
    ground = S(start.p, start.R)
    longest = 2.0 * np.sqrt(values[-1])

    def edge(u: Array) -> tuple[float, Array]:
        """Return S above the well at the edge in direction u (6,), and the way there.

        Zero is no direction; a search along a line may pass it, and gets the first one there.
        """
        size = float(np.linalg.norm(u))
        way = shape @ (u / size) if size > 0.0 else shape[:, 0]
        near, far = 0.0, 0.0
        step = 0.02 / float(np.linalg.norm(way / scale))
        while outside(*displaced(start.p, start.R, far * way)) is None:
            near, far = far, far + step
            if far > 100.0 * longest:
                return np.inf, far * way
        for _ in range(20):
            middle = (near + far) / 2.0
            inside = outside(*displaced(start.p, start.R, middle * way)) is None
            near, far = (middle, far) if inside else (near, middle)
        return S(*displaced(start.p, start.R, far * way)) - ground, far * way

    from scipy.optimize import minimize  # noqa: PLC0415 - `hil check` does without

    directions = np.random.default_rng(1).standard_normal((rays, 6))
    directions = np.vstack([directions, np.eye(6), -np.eye(6)])
    heights = np.array([edge(u)[0] for u in directions])
    lowest = directions[np.argsort(heights)[:5]]
    options = {"maxfev": 300}
    found = [minimize(lambda u: edge(u)[0], u, method="Powell", options=options) for u in lowest]
    level, way = edge(min(found, key=lambda result: result.fun).x)
    p, R = displaced(start.p, start.R, way)
    return Basin(float(level), p, outside(p, R) or "the edge of the region")
