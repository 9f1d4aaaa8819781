"""The structured singular value: textbook matrices, proofs by the scales, and bounds of SLICOT."""

import numpy as np
import pytest

from drivers.errors import ModelError
from hil.design.synthesis.mu import Block, upper_bound

SCALAR = Block()
BLOCKS = [Block(), Block(), Block(), Block(3, 2)]


def one(matrix):
    return np.array(matrix, complex)[None]


def samples(number, rows, columns, seed=0):
    rng = np.random.default_rng(seed)
    M = rng.normal(size=(number, rows, columns)) + 1j * rng.normal(size=(number, rows, columns))
    return M * 10.0 ** rng.uniform(-1.5, 1.5, size=(number, rows, 1))


def bound(matrix, blocks):
    return upper_bound(one(matrix), blocks, accuracy=1e-6).bound[0]


def test_mu_of_the_textbook_matrix_is_3_and_its_singular_value_sqrt_10():
    """Skogestad and Postlethwaite, section 8.8: sqrt 10 for a full block, 3 for a diagonal one."""
    M = [[2.0, 2.0], [-1.0, -1.0]]
    assert bound(M, [Block(2, 2)]) == pytest.approx(np.sqrt(10.0), rel=1e-6)
    assert bound(M, [SCALAR, SCALAR]) == pytest.approx(3.0, rel=1e-6)


def test_mu_of_a_rank_one_matrix_is_the_sum_of_the_products():
    """M = a b': det(I - M Delta) = 1 - sum a_i b_i delta_i, so mu = sum |a_i b_i|."""
    a, b = np.array([3.0, -0.2, 0.7]), np.array([0.1, 5.0, 2.0])
    M, mu = np.outer(a, b), np.abs(a * b).sum()
    assert bound(M, [SCALAR] * 3) == pytest.approx(mu, rel=1e-5)
    assert mu < 0.5 * np.linalg.norm(M, 2)


def test_mu_upper_bound_is_proven_by_its_scales_and_exceeded_by_no_perturbation():
    M = samples(30, 5, 6)
    upper = upper_bound(M, BLOCKS)
    left = np.repeat(upper.D, [1, 1, 1, 2], axis=1)
    right = np.repeat(upper.D, [1, 1, 1, 3], axis=1)
    sigma = np.linalg.svd(left[:, :, None] * M / right[:, None, :], compute_uv=False)[:, 0]
    assert upper.bound == pytest.approx(sigma, rel=1e-9)
    draw, largest = np.random.default_rng(2), np.zeros(30)
    for _ in range(300):
        Delta = np.zeros((6, 5), complex)
        Delta[[0, 1, 2], [0, 1, 2]] = np.exp(2j * np.pi * draw.random(3))
        full = draw.normal(size=(3, 2)) + 1j * draw.normal(size=(3, 2))
        Delta[3:, 3:] = full / np.linalg.norm(full, 2)
        largest = np.maximum(largest, np.abs(np.linalg.eigvals(M @ Delta)).max(axis=1))
    assert (largest <= upper.bound * (1 + 1e-9)).all()
    assert (largest > 0.3 * upper.bound).all()


def test_mu_upper_bound_is_as_tight_as_that_of_slicot():
    slycot = pytest.importorskip("slycot")
    M = samples(40, 5, 5, seed=3)
    reference = [slycot.ab13md(m, np.array([1, 1, 1, 2]), np.array([2, 2, 2, 2]))[0] for m in M]
    found = upper_bound(M, [SCALAR] * 3 + [Block(2, 2)], accuracy=1e-6).bound
    assert found == pytest.approx(reference, rel=1e-3)
    assert (found <= np.array(reference) * (1 + 1e-3)).all()


def test_mu_blocks_that_do_not_fit_the_matrix_are_refused():
    with pytest.raises(ModelError, match="blocks for a matrix of 1 x 1"):
        upper_bound(one(np.eye(2)), [SCALAR])
