"""A rigid body as ten parameters: the force that its motion needs, and which parameters are possible.

theta = [m, m c, I_xx, I_yy, I_zz, I_xy, I_xz, I_yz]: mass, first moments and inertia about the platform's
origin, platform axes. Force and moment are linear in them (C. G. Atkeson, C. H. An and J. M. Hollerbach, Int.
J. Robotics Research 5(3), 1986). They belong to a body if and only if the pseudo-inertia is positive definite
(P. M. Wensing, S. Kim and J.-J. E. Slotine, IEEE Robotics and Automation Letters 3(1), 2018).
"""

import numpy as np

from drivers.arrays import Array
from hil.robot.geometry import Body
from hil.robot.inertia import steiner

NAMES = ("mass", "m x", "m y", "m z", "I_xx", "I_yy", "I_zz", "I_xy", "I_xz", "I_yz")
UNITS = ("kg", "kg m", "kg m", "kg m", *6 * ("kg m^2",))
SIZE = len(NAMES)
_TENSOR = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])
"""Index of the element at each place of the tensor."""
_ELEMENTS = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
"""Row and column in the tensor of each of the six elements."""


def tensor(elements: Array) -> Array:
    """Inertia tensor (3, 3) kg m^2 from [I_xx, I_yy, I_zz, I_xy, I_xz, I_yz]."""
    I: Array = elements[_TENSOR]
    return I


def parameters_of(body: Body) -> Array:
    """Parameters theta (10,) of a body about the platform's origin, platform axes; kg, kg m, kg m^2."""
    I = body.inertia + steiner(body.mass, body.com)
    return np.array([body.mass, *(body.mass * body.com), *I[_ELEMENTS]])


def body_of(theta: Array) -> Body:
    """Body with parameters theta (10,), mass > 0: its inertia is about its centre of mass."""
    m = float(theta[0])
    c = theta[1:4] / m
    return Body(m, c, tensor(theta[4:]) - steiner(m, c))


def pseudo_inertia(theta: Array) -> Array:
    """Pseudo-inertia [[tr(I)/2 1 - I, m c], [m c^T, m]], (4, 4): the integral of [x; 1] [x; 1]^T dm."""
    I = tensor(theta[4:])
    P = np.empty((4, 4))
    P[:3, :3] = 0.5 * np.trace(I) * np.eye(3) - I
    P[:3, 3] = P[3, :3] = theta[1:4]
    P[3, 3] = theta[0]
    return P


def from_pseudo_inertia(P: Array) -> Array:
    """Parameters theta (10,) from a pseudo-inertia (4, 4): I = tr(S) 1 - S, S its upper left block."""
    I = np.trace(P[:3, :3]) * np.eye(3) - P[:3, :3]
    return np.array([P[3, 3], *P[:3, 3], *I[_ELEMENTS]])


def regressor(R: Array, twist: Array, dtwist: Array, gravity: Array) -> Array:
    """Regressor Y (n, 6, 10): Y theta is the force and moment about the platform's origin that move the body.

    F = m (dv - g) + dw x h + w x (w x h), N = I dw + w x I w + h x (dv - g), h = m c (Newton, Euler), both in
    platform axes and rotated to base axes by R (n, 3, 3), x_base = p + R x_platform. twist, dtwist (n, 6)
    m/s, rad/s and their rates, of the platform's origin, and gravity (3,) m/s^2: base frame.
    """
    a = np.einsum("nji,nj->ni", R, dtwist[:, :3] - gravity)
    w = np.einsum("nji,nj->ni", R, twist[:, 3:])
    dw = np.einsum("nji,nj->ni", R, dtwist[:, 3:])
    W = _cross(w)
    Y = np.zeros((len(R), 6, SIZE))
    Y[:, :3, 0] = a
    Y[:, :3, 1:4] = _cross(dw) + W @ W
    Y[:, 3:, 1:4] = -_cross(a)
    Y[:, 3:, 4:] = _inertia_times(dw) + W @ _inertia_times(w)
    Y[:, :3] = R @ Y[:, :3]
    Y[:, 3:] = R @ Y[:, 3:]
    return Y


def _cross(x: Array) -> Array:
    """Cross product matrices (n, 3, 3) of vectors x (n, 3)."""
    return np.asarray(np.cross(x[:, None], np.eye(3)).transpose(0, 2, 1), np.float64)


def _inertia_times(x: Array) -> Array:
    """Matrices L (n, 3, 6) with L [I_xx, I_yy, I_zz, I_xy, I_xz, I_yz]^T = I x, for vectors x (n, 3)."""
    return np.asarray(np.einsum("nj,ije->nie", x, np.eye(6)[_TENSOR]), np.float64)
