"""Linear time-invariant systems in state space, continuous or sampled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.signal import cont2discrete

from drivers.arrays import Array, ComplexArray
from drivers.errors import ModelError


class LinearSystem(NamedTuple):
    """dx/dt = A x + B u, y = C x + D u; with a period x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k]."""

    A: Array
    """(n, n)."""
    B: Array
    """(n, inputs)."""
    C: Array
    """(outputs, n)."""
    D: Array
    """(outputs, inputs)."""
    period_s: float | None = None
    """None: continuous."""

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.A)

    def poles(self) -> ComplexArray:
        """Return the eigenvalues of A (n,), rad/s where continuous."""
        return np.asarray(np.linalg.eigvals(self.A), np.complex128)

    def is_stable(self) -> bool:
        """Tell whether all poles decay."""
        poles = self.poles()
        return bool((poles.real < 0).all() if self.period_s is None else (np.abs(poles) < 1).all())

    def response(self, omega: Array) -> ComplexArray:
        """Return the frequency response (len(omega), outputs, inputs) at omega, rad/s."""
        omega = np.asarray(omega, float)
        z = 1j * omega if self.period_s is None else np.exp(1j * omega * self.period_s)
        resolvent = z[:, None, None] * np.eye(self.order) - self.A
        gain = self.C @ np.linalg.solve(resolvent, np.broadcast_to(self.B, (len(z), *self.B.shape)))
        return np.asarray(gain + self.D, np.complex128)

    def after(self, first: LinearSystem) -> LinearSystem:
        """Return the series: `first`, then this one."""
        _same_time(self, first)
        A = np.block([[first.A, np.zeros((first.order, self.order))], [self.B @ first.C, self.A]])
        B = np.vstack([first.B, self.B @ first.D])
        return LinearSystem(A, B, np.hstack([self.D @ first.C, self.C]), self.D @ first.D, self.period_s)

    def beside(self, other: LinearSystem) -> LinearSystem:
        """Return both side by side: inputs and outputs of this one first."""
        _same_time(self, other)
        A, B, C, D = (block_diag(mine, yours) for mine, yours in zip(self[:4], other[:4], strict=True))
        return LinearSystem(A, B, C, D, self.period_s)

    def closed_with(self, lower: LinearSystem) -> LinearSystem:
        """Return the loop from the last outputs through `lower` to the last inputs (a lower LFT).

        Positive feedback: a controller that subtracts has the minus in it.

        Raises ModelError where the loop is not well posed.
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
        """Return the system sampled with ``zoh`` (a plant behind a hold) or ``bilinear`` (a controller)."""
        if self.period_s is not None:
            raise ModelError("the system is sampled already")
        A, B, C, D, _ = cont2discrete(self[:4], period_s, method=method)
        return LinearSystem(A, B, C, D, period_s)


def static(gain: Array, period_s: float | None = None) -> LinearSystem:
    """Return a gain as a system without states."""
    gain = np.atleast_2d(np.asarray(gain, float))
    outputs, inputs = gain.shape
    return LinearSystem(np.zeros((0, 0)), np.zeros((0, inputs)), np.zeros((outputs, 0)), gain, period_s)


def lag(time_s: float) -> LinearSystem:
    """Return 1 / (T s + 1); T = 0: a gain of 1."""
    if time_s == 0.0:
        return static(np.eye(1))
    rate = np.array([[1.0 / time_s]])
    return LinearSystem(-rate, rate, np.eye(1), np.zeros((1, 1)))


def _same_time(one: LinearSystem, other: LinearSystem) -> None:
    if one.period_s != other.period_s:
        raise ModelError(f"systems of different time: periods {one.period_s} and {other.period_s} s")
