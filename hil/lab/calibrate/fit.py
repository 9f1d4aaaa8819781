"""Joint centres and length offsets from measured pairs of pose and leg lengths, by least squares.

The parameters of a leg are base x y z, platform x y z, offset, all in m; the legs follow one another.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve, qr
from scipy.optimize import least_squares
from scipy.special import gammaincc

from drivers.arrays import Array
from drivers.errors import CalibrationError
from hil.mathematics.rotations import rotation_from_vector
from hil.robot.geometry import Platform

NAMES = ("base x", "base y", "base z", "platform x", "platform y", "platform z", "offset")
"""Parameters of one leg."""
MIN_POSES = 8
"""Six equations per pose and seven unknowns per leg: seven poses would leave no residual."""
RANK = 1e-6
"""Singular value of a leg's Jacobian, relative to the largest, below which a direction is undetermined."""
NOISE = 5.0
"""The same limit, as a multiple of the effect of the measured poses' own noise."""
SHARE = 0.02
"""A parameter with a larger share than this in undetermined directions is itself undetermined."""
WEAK = 1e-3
"""m: standard deviation of a parameter above which a warning is given."""


class Measurements(NamedTuple):
    """Measured pairs: n platform poses and the readings of the six legs at each."""

    p: Array
    """(n, 3) m, platform origin in the base frame."""
    rotation_vector: Array
    """(n, 3) rad, R = exp([r]x), x_base = p + R x_platform; at most half a turn."""
    q: Array
    """(n, 6) m, distance of the joint centres plus an unknown offset per leg."""
    length_std: Array | None = None
    """(n,) m, standard deviation of each reading; None: unknown, estimated from the residuals."""
    position_std: Array | float = 0.0
    """(n,) m, standard deviation of each coordinate of a measured pose; only with `length_std`."""
    rotation_std: Array | float = 0.0
    """(n,) rad, standard deviation of each angle of a measured pose; only with `length_std`."""

    def rotations(self) -> Array:
        """Rotation matrices R (n, 3, 3)."""
        return np.array([rotation_from_vector(r) for r in self.rotation_vector])


class Combination(NamedTuple):
    """A linear combination of one leg's parameters that the poses do not determine."""

    leg: int
    coefficients: dict[str, float]
    """Name of the parameter -> its share, the largest 1."""


class Calibration(NamedTuple):
    """Least-squares fit of the joint centres and length offsets of six legs to measured poses."""

    base_joints: Array
    """(6, 3) m, like `platform_joints` in the frames of the measured poses."""
    platform_joints: Array
    offsets: Array
    """(6,) m, reading minus distance of the joint centres."""
    std: Array
    """(6, 7) m, standard deviation of each parameter; nan if undetermined by itself."""
    covariance: Array
    """(42, 42) m^2 of all parameters, zero along undetermined directions."""
    residuals: Array
    """(n, 6) m, reading minus fitted reading."""
    standardised: Array
    """(n, 6), residuals over their standard deviations."""
    dof: int
    """Degrees of freedom: number of equations minus determined parameters."""
    chi_square: float | None
    """Sum of squared whitened residuals; about `dof` if the given deviations are right."""
    p_value: float | None
    """Probability of a larger chi-square; like `chi_square` None without `length_std`."""
    sigma: float
    """m, standard deviation of a reading: estimated, or root mean square of the given ones."""
    undetermined: list[Combination]
    """Undetermined combinations, kept at their start values."""


def predicted(platform: Platform, measured: Measurements) -> Array:
    """Leg lengths (n, 6) m of `platform` at the measured poses: |p + R b_i - a_i|."""
    return _model(_start(platform), measured.p, measured.rotations())[0]


def start_offsets(platform: Platform, measured: Measurements) -> Array:
    """Offset (6,) m of each leg before a fit: median of reading minus length of `platform`."""
    return np.median(measured.q - predicted(platform, measured), axis=0)


def suspicion(platform: Platform, measured: Measurements) -> str | None:
    """Other unit or pose direction that explains the readings 5 times better; None if there is no such."""

    def spread(m: Measurements) -> float:
        return float(np.std(m.q - predicted(platform, m), axis=0).max())

    p, r, q = measured.p, measured.rotation_vector, measured.q
    back = -np.einsum("kji,kj->ki", measured.rotations(), p)
    others = {
        "positions and lengths are in mm instead of m": Measurements(p / 1e3, r, q / 1e3),
        "positions are in mm instead of m": Measurements(p / 1e3, r, q),
        "lengths are in mm instead of m": Measurements(p, r, q / 1e3),
        "the poses are inverse (base in the platform's frame)": Measurements(back, -r, q),
    }
    if float(np.linalg.norm(r, axis=1).max()) <= np.pi**2 / 180:
        others["rotation vectors are in rad instead of deg"] = Measurements(p, np.rad2deg(r), q)
    as_given = spread(measured)
    least, best = min((spread(other), name) for name, other in others.items())
    # Below a hundredth of the robot's size it may as well be the joints that are wrong.
    return best if as_given > 0.01 * np.abs(platform.base_joints).max() and least < as_given / 5 else None


def calibrate(platform: Platform, measured: Measurements) -> Calibration:
    """Fit a_i, b_i and the offset o_i of six legs to measured pairs.

    Minimises the sum over poses of e_k^T C_k^-1 e_k, e_ki = q_ki - |p_k + R_k b_i - a_i| - o_i (Masory, Wang
    and Zhuang 1993 fit the same 42 parameters), C_k = sigma_l^2 1 + J_k diag(sigma_p^2, sigma_r^2) J_k^T. C_k
    couples the legs through the error of their common pose. Without deviations C_k = 1, the legs decouple,
    and the covariance is scaled by the residuals. Undetermined directions (by the singular values of each
    leg's Jacobian) keep their start values: the joints of `platform` and the median offset.

    Raises CalibrationError: fewer than 8 poses, or no convergence.
    """
    n, R = len(measured.p), measured.rotations()
    if n < MIN_POSES:
        raise CalibrationError(
            f"{n} poses, allowed: at least {MIN_POSES}. Each leg has 7 unknowns (two joints and an offset) "
            "and one equation per pose; measure some 30, all over the workspace, tilted about all axes"
        )
    theta = _start(platform)
    theta[:, 6] = start_offsets(platform, measured)
    _, slopes = _model(theta, measured.p, R)
    turn, shift = (np.sqrt(np.mean(np.square(std))) for std in (measured.rotation_std, measured.position_std))
    length = np.linalg.norm(measured.p[:, None] - theta[None, :, 0:3], axis=2).mean()
    kept, lost = _split(slopes, max(RANK, NOISE * float(turn + shift / length)))
    basis = block_diag(*kept)
    rank = basis.shape[1]
    # Weights depend on the directions of the legs alone: a second pass settles them.
    for _ in range(2):
        theta, J, white = _solve(theta, measured, R, basis)
    cov_z = cho_solve(cho_factor(J.T @ J), np.eye(rank))
    chi_square, dof = float(white @ white), 6 * n - rank
    given = measured.length_std is not None
    scale = 1.0 if given else chi_square / dof
    covariance = basis @ cov_z @ basis.T * scale
    residuals = measured.q - _model(theta, measured.p, R)[0]
    own = np.sqrt(np.einsum("kii->ki", _noise(theta, measured, R)) * scale)
    share = np.array([np.sqrt((V**2).sum(axis=1)) for V in lost])
    std = np.sqrt(np.diag(covariance)).reshape(6, 7)
    return Calibration(
        base_joints=theta[:, 0:3].copy(),
        platform_joints=theta[:, 3:6].copy(),
        offsets=theta[:, 6].copy(),
        std=np.where(share > SHARE, np.nan, std),
        covariance=covariance,
        residuals=residuals,
        standardised=residuals / np.where(own > 0, own, 1.0),
        dof=dof,
        chi_square=chi_square if given else None,
        p_value=float(gammaincc(dof / 2, chi_square / 2)) if given else None,
        sigma=float(np.sqrt(scale if measured.length_std is None else np.mean(measured.length_std**2))),
        undetermined=[c for leg in range(6) for c in _combinations(leg, lost[leg])],
    )


def _start(platform: Platform) -> Array:
    return np.hstack([platform.base_joints, platform.platform_joints, np.zeros((6, 1))])


def _model(theta: Array, p: Array, R: Array) -> tuple[Array, Array]:
    """Fitted readings (n, 6) m and slopes (n, 6, 7): -s, R^T s and 1, s the unit vector along the leg."""
    legs = p[:, None, :] + np.einsum("kij,lj->kli", R, theta[:, 3:6]) - theta[None, :, 0:3]
    length = np.sqrt((legs**2).sum(axis=2))
    s = legs / length[:, :, None]
    slopes = np.concatenate([-s, np.einsum("kij,kli->klj", R, s), np.ones((*length.shape, 1))], axis=2)
    return length + theta[:, 6], slopes


def _noise(theta: Array, measured: Measurements, R: Array) -> Array:
    """C_k (n, 6, 6) m^2: covariance of the readings at a pose, including the error of the pose."""
    n = len(measured.p)
    if measured.length_std is None:
        return np.tile(np.eye(6), (n, 1, 1))
    _, slopes = _model(theta, measured.p, R)
    s = -slopes[:, :, 0:3]
    arm = np.einsum("kij,lj->kli", R, theta[:, 3:6])
    var_q, var_p, var_r = (
        np.reshape(np.square(std), (-1, 1, 1))
        for std in (measured.length_std, measured.position_std, measured.rotation_std)
    )
    turn = np.cross(arm, s)
    C = np.einsum("kli,kmi->klm", s, s) * var_p + np.einsum("kli,kmi->klm", turn, turn) * var_r
    return np.asarray(C + np.eye(6) * var_q)


def _solve(theta: Array, measured: Measurements, R: Array, basis: Array) -> tuple[Array, Array, Array]:
    """Fitted parameters (6, 7) m, whitened Jacobian in the basis, and whitened residuals."""
    W = np.linalg.inv(np.linalg.cholesky(_noise(theta, measured, R)))
    rows, rank = measured.q.size, basis.shape[1]

    def whitened(z: Array) -> Array:
        e = measured.q - _model(theta + (basis @ z).reshape(6, 7), measured.p, R)[0]
        return np.asarray(np.einsum("klm,km->kl", W, e).ravel())

    def jacobian(z: Array) -> Array:
        _, slopes = _model(theta + (basis @ z).reshape(6, 7), measured.p, R)
        each = -W[:, :, :, None] * slopes[:, None, :, :]
        return np.asarray(each.reshape(rows, 42) @ basis)

    fit = least_squares(
        whitened, np.zeros(rank), jacobian, method="lm", xtol=1e-12, ftol=1e-14, gtol=1e-12, max_nfev=500
    )
    if not fit.success:
        raise CalibrationError(
            f"no convergence in {fit.nfev} evaluations: {fit.message}. Check that the readings are from this "
            "robot, legs in the order of the joint lists"
        )
    solution = theta + (basis @ fit.x).reshape(6, 7)
    return solution, jacobian(fit.x), whitened(fit.x)


def _split(slopes: Array, floor: float) -> tuple[list[Array], list[Array]]:
    """Split each leg's parameters into directions that the poses determine, scaled by size, and the rest.

    floor: relative singular value below which a direction counts as undetermined.
    """
    kept, lost = [], []
    for leg in range(6):
        _, s, Vt = np.linalg.svd(slopes[:, leg, :], full_matrices=False)
        good = s > floor * s[0]
        kept.append(Vt[good].T / s[good])
        lost.append(Vt[~good].T)
    return kept, lost


def _combinations(leg: int, V: Array) -> list[Combination]:
    """Basis of a subspace (7, k) with as few parameters per vector as possible, by pivoted QR."""
    k = V.shape[1]
    if k == 0:
        return []
    _, R, order = qr(V.T, mode="economic", pivoting=True)
    A = np.empty((k, 7))
    A[:, order] = np.linalg.solve(R[:, :k], R)
    A /= np.take_along_axis(A, np.abs(A).argmax(axis=1)[:, None], axis=1)
    shares = [zip(NAMES, row.tolist(), strict=True) for row in A]
    return [Combination(leg, {name: v for name, v in row if abs(v) >= 0.1}) for row in shares]
