"""Linear time-invariant systems in state space, continuous or sampled."""

from __future__ import annotations

from math import ceil, isfinite, log2
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, ComplexArray
from drivers.errors import ModelError


class LinearSystem(NamedTuple):
    """dx/dt = A x + B u, y = C x + D u; with a period: x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k]."""

    A: Array
    """(n, n)."""
    B: Array
    """(n, inputs)."""
    C: Array
    """(outputs, n)."""
    D: Array
    """(outputs, inputs)."""
    period_s: float | None = None
    """Sampling period, s; None: continuous time."""

    @property
    def order(self) -> int:
        """Number n of states."""
        return len(self.A)

    def poles(self) -> ComplexArray:
        """Poles (n,), the eigenvalues of A: in rad/s in continuous time, in z for a sampled system."""
        return np.asarray(np.linalg.eigvals(self.A), np.complex128)

    def is_stable(self) -> bool:
        """True if all poles are in the left half plane, or, of a sampled system, inside the unit circle."""
        poles = self.poles()
        return bool((poles.real < 0).all() if self.period_s is None else (np.abs(poles) < 1).all())

    def response(self, omega: Array) -> ComplexArray:
        """Frequency response (len(omega), outputs, inputs) at the frequencies omega, rad/s."""
        omega = np.asarray(omega, float)
        z = 1j * omega if self.period_s is None else np.exp(1j * omega * self.period_s)
        resolvent = z[:, None, None] * np.eye(self.order) - self.A
        gain = self.C @ np.linalg.solve(resolvent, np.broadcast_to(self.B, (len(z), *self.B.shape)))
        return np.asarray(gain + self.D, np.complex128)

    def after(self, first: LinearSystem) -> LinearSystem:
        """Series connection: the outputs of `first` are the inputs of this system."""
        _same_time(self, first)
        A = np.block([[first.A, np.zeros((first.order, self.order))], [self.B @ first.C, self.A]])
        B = np.vstack([first.B, self.B @ first.D])
        return LinearSystem(A, B, np.hstack([self.D @ first.C, self.C]), self.D @ first.D, self.period_s)

    def beside(self, other: LinearSystem) -> LinearSystem:
        """Both systems side by side, uncoupled; inputs and outputs of this system come first."""
        _same_time(self, other)
        A, B, C, D = (_diagonal(mine, yours) for mine, yours in zip(self[:4], other[:4], strict=True))
        return LinearSystem(A, B, C, D, self.period_s)

    def closed_with(self, lower: LinearSystem) -> LinearSystem:
        """Close the loop from the last outputs through `lower` to the last inputs (lower LFT).

        Feedback is positive: a controller with negative feedback contains the minus sign.

        Raises ModelError if the loop is not well posed.
        """
        _same_time(self, lower)
        inputs, outputs = self.B.shape[1] - lower.C.shape[0], self.C.shape[0] - lower.B.shape[1]
        B1, B2 = self.B[:, :inputs], self.B[:, inputs:]
        C1, C2 = self.C[:outputs], self.C[outputs:]
        D11, D12 = self.D[:outputs, :inputs], self.D[:outputs, inputs:]
        D21, D22 = self.D[outputs:, :inputs], self.D[outputs:, inputs:]
        M = np.eye(len(D22)) - D22 @ lower.D
        if np.linalg.cond(M) > 1e12:
            raise ModelError("the loop is not well posed: I - D22 D of the controller is singular")
        E = np.linalg.inv(M)  # y2 = E (C2 x + D21 w + D22 C_k x_k)
        from_x, from_k, from_w = E @ C2, E @ D22 @ lower.C, E @ D21
        u_x, u_k, u_w = lower.D @ from_x, lower.D @ from_k + lower.C, lower.D @ from_w
        A = np.block([[self.A + B2 @ u_x, B2 @ u_k], [lower.B @ from_x, lower.A + lower.B @ from_k]])
        B = np.vstack([B1 + B2 @ u_w, lower.B @ from_w])
        return LinearSystem(A, B, np.hstack([C1 + D12 @ u_x, D12 @ u_k]), D11 + D12 @ u_w, self.period_s)

    def sampled(self, period_s: float, method: str = "zoh") -> LinearSystem:
        """Discretise with ``zoh`` (a plant behind a zero-order hold) or ``bilinear`` (a controller)."""
        if self.period_s is not None:
            raise ModelError("the system is already sampled")
        if method == "zoh":
            return LinearSystem(*held(self.A, self.B, period_s), self.C, self.D, period_s)
        half = 0.5 * period_s * self.A
        inverse = np.asarray(np.linalg.inv(np.eye(self.order) - half), np.float64)
        A, B, C = inverse @ (np.eye(self.order) + half), inverse @ (period_s * self.B), self.C @ inverse
        return LinearSystem(A, B, C, self.D + 0.5 * self.C @ B, period_s)


def held(A: Array, B: Array, time_s: float) -> tuple[Array, Array]:
    """Exact sampling of dx/dt = A x + B u, u held: exp(A t) (n, n), integral of exp(A s) B over 0 .. t."""
    n, inputs = B.shape
    block = np.zeros((n + inputs, n + inputs))
    block[:n, :n], block[:n, n:] = A, B
    e = exponential(block * time_s)
    return e[:n, :n], e[:n, n:]


_PADE = (
    64764752532480000.0, 32382376266240000.0, 7771770303897600.0, 1187353796428800.0, 129060195264000.0,
    10559470521600.0, 670442572800.0, 33522128640.0, 1323241920.0, 40840800.0, 960960.0, 16380.0, 182.0, 1.0,
)  # fmt: skip


def exponential(A: Array) -> Array:
    """exp(A) (n, n) by scaling, the Pade approximation of order 13, and squaring.

    N. J. Higham, SIAM J. Matrix Anal. Appl. 26 (2005), algorithm 2.3.
    """
    size = float(np.abs(A).sum(axis=0).max(initial=0.0))
    if not isfinite(size):
        raise ModelError("a system with infinite or undefined entries cannot be sampled")
    squarings = max(0, ceil(log2(size / 5.37))) if size > 0.0 else 0
    A, b = A / 2.0**squarings, _PADE
    I, A2 = np.eye(len(A)), A @ A
    A4 = A2 @ A2
    A6 = A4 @ A2
    U = A @ (A6 @ (b[13] * A6 + b[11] * A4 + b[9] * A2) + b[7] * A6 + b[5] * A4 + b[3] * A2 + b[1] * I)
    V = A6 @ (b[12] * A6 + b[10] * A4 + b[8] * A2) + b[6] * A6 + b[4] * A4 + b[2] * A2 + b[0] * I
    e = I + np.asarray(np.linalg.solve(V - U, 2.0 * U), np.float64)  # rounds to 1 an integrator's pole
    for _ in range(squarings):
        e = e @ e
    return e


def static(gain: Array, period_s: float | None = None) -> LinearSystem:
    """Constant gain (outputs, inputs) as a linear system without states."""
    gain = np.atleast_2d(np.asarray(gain, float))
    outputs, inputs = gain.shape
    return LinearSystem(np.zeros((0, 0)), np.zeros((0, inputs)), np.zeros((outputs, 0)), gain, period_s)


def lag(time_s: float) -> LinearSystem:
    """Linear system 1 / (T s + 1), a first-order lag with T = time_s; a gain of 1 for T = 0."""
    if time_s == 0.0:
        return static(np.eye(1))
    rate = np.array([[1.0 / time_s]])
    return LinearSystem(-rate, rate, np.eye(1), np.zeros((1, 1)))


def _diagonal(a: Array, b: Array) -> Array:
    return np.block([[a, np.zeros((len(a), b.shape[1]))], [np.zeros((len(b), a.shape[1])), b]])


def _same_time(one: LinearSystem, other: LinearSystem) -> None:
    if one.period_s != other.period_s:
        raise ModelError(f"cannot combine systems with sample periods {one.period_s} and {other.period_s} s")
