"""Linear algebra, rotations, trigonometry and linear systems, against LAPACK, SciPy and textbooks."""

from __future__ import annotations

import hashlib
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drivers.errors import ModelError
from hil.mathematics.linear_algebra import condition_kernel, solve, solve_transposed
from hil.mathematics.linear_system import LinearSystem, static
from hil.mathematics.rotations import (
    relative_rotation,
    rotation_from_vector,
    rotation_motion_kernel,
    rotation_vector,
    rotation_vector_rate,
)
from hil.mathematics.rounding import lowered, raised
from hil.mathematics.trigonometry import sincos

DATA = Path(__file__).parents[1] / "data"
VECTOR = st.lists(st.floats(-1.7, 1.7), min_size=3, max_size=3).map(np.array)


def test_linear_solver_agrees_with_lapack():
    rng = np.random.default_rng(0)
    needs_pivoting = np.roll(np.eye(6), 1, axis=0)
    needs_pivoting[0, 0] = 1e-300
    for A in [needs_pivoting, *rng.normal(size=(200, 6, 6))]:
        b = rng.normal(size=6)
        for found, x in (
            (solve(A, b), np.linalg.solve(A, b)),
            (solve_transposed(A, b), np.linalg.solve(A.T, b)),
        ):
            assert np.abs(found - x).max() <= 1e-14 * np.linalg.cond(A) * np.abs(x).max()


@pytest.mark.parametrize("bad", [np.zeros((6, 6)), np.full((6, 6), np.nan), np.full((6, 6), np.inf)])
def test_a_singular_matrix_gives_nan_and_infinite_condition(bad):
    assert np.isnan(solve(bad, np.ones(6))).all()
    assert np.isnan(solve_transposed(bad, np.ones(6))).all()
    assert condition_kernel(bad, 1.0) == np.inf


def test_condition_number_estimate_is_at_most_a_quarter_above_the_exact_value():
    rng = np.random.default_rng(1)
    for k in range(300):
        U, _, V = np.linalg.svd(rng.normal(size=(6, 6)))
        A = np.ascontiguousarray(U * 10.0 ** rng.uniform(-k / 60, k / 60, 6) @ V)
        r = 10.0 ** rng.uniform(-1, 1)
        exact = np.linalg.cond(A / np.array([1, 1, 1, r, r, r]))
        assert exact * (1 - 1e-6) <= condition_kernel(A, r) <= exact * 6 ** (1 / 8) * (1 + 1e-6)


@given(VECTOR)
def test_rotation_vector_and_matrix_agree_with_scipy(r):
    R = rotation_from_vector(r)
    assert np.abs(R - Rotation.from_rotvec(r).as_matrix()).max() <= 4e-15
    assert rotation_from_vector(rotation_vector(R)) == pytest.approx(R, abs=4e-15)
    if np.linalg.norm(r) < 3.1:
        assert rotation_vector(R) == pytest.approx(r, abs=1e-13)


def test_rotation_vectors_of_half_turns_and_of_no_rotation():
    for axis in np.vstack([np.eye(3), [[0.6, 0.8, 0.0], [-0.6, 0.0, 0.8]]]):
        R = 2 * np.outer(axis, axis) - np.eye(3)
        r = rotation_vector(R)
        assert np.linalg.norm(r) == pytest.approx(np.pi, abs=1e-15)
        assert np.abs(np.cross(r, axis)).max() <= 1e-15
    assert np.array_equal(rotation_vector(np.eye(3)), np.zeros(3))


@given(VECTOR, VECTOR, VECTOR)
@settings(max_examples=50)
def test_rotation_vector_rates_agree_with_finite_differences(r, dr, ddr):
    h = 1e-4
    _, omega, alpha = rotation_motion_kernel(r, dr, ddr)

    def at(t):
        return Rotation.from_rotvec(r + t * dr + t * t / 2 * ddr)

    def rate(t):
        return (at(t + h) * at(t - h).inv()).as_rotvec() / (2 * h)

    assert omega == pytest.approx(rate(0.0), abs=1e-6)
    assert alpha == pytest.approx((rate(h) - rate(-h)) / (2 * h), abs=1e-5)


BITS = """
import hashlib, json, sys
import numpy as np
from drivers.tick_columns import new_record
from hil.robot.dynamics import Model
from hil.estimation.pose import Estimator
from hil.robot.geometry import Platform
from hil.robot.dynamics_kernels import joint_idc_kernel
from hil.mathematics.rotations import rotation_motion_kernel, rotation_vector
truth = json.load(open(sys.argv[1]))
digest = hashlib.sha256()
for case in truth["cases"]:
    platform, s = Platform.from_dict(truth["geometries"][case["geometry"]]), case["state"]
    model = Model(platform, leg_spin="universal")
    e = new_record()
    e["q"], e["dq"] = case["expected"]["lengths"], case["expected"]["rates"]
    Estimator(platform, s["fk_guess_p"], s["fk_guess_R"]).update(e)
    p, R, twist, J = (e[name] for name in ("p", "R", "twist", "J"))
    tau = joint_idc_kernel(model.constants, model.code, p, R, twist, J, np.ones(6), np.ones(6))
    r = rotation_vector(R)
    for x in (p, R, twist, J, e["condition"], tau, r, *rotation_motion_kernel(r, r, r)):
        digest.update(x.tobytes())
print(digest.hexdigest())
"""


@pytest.mark.long
def test_results_are_bit_equal_with_other_blas_and_libm_variants():
    variants = [
        {},
        {
            "OPENBLAS_CORETYPE": "Nehalem",
            "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX2_Usable,-FMA_Usable",
        },
    ]
    seen = set()
    for variant in variants:
        run = subprocess.run(
            [sys.executable, "-c", BITS, str(DATA / "rigid_body_cases.json")],
            env={**os.environ, **variant},
            capture_output=True,
            text=True,
            check=True,
            timeout=120,
        )
        seen.add(run.stdout.strip())
    assert len(seen) == 1
    assert len(seen.pop()) == hashlib.sha256().digest_size * 2


@pytest.mark.parametrize("angle", [0.2, 1.7, 3.1, 4.5])
def test_rotation_vector_rate_agrees_with_the_closed_form(angle):
    """dr = w - r x w / 2 + (1 - (a/2) cot(a/2)) / a^2 r x (r x w), also beyond half a turn."""
    r, omega = angle * np.array([0.6, 0.0, -0.8]), np.array([0.3, -1.0, 0.7])
    D = (1 - angle / 2 / np.tan(angle / 2)) / angle**2
    turned = np.cross(r, omega)
    expected = omega - turned / 2 + D * np.cross(r, turned)
    np.testing.assert_allclose(rotation_vector_rate(r, omega), expected, rtol=0, atol=1e-13)


def test_relative_rotation_is_the_shortest_one_in_the_base_frame():
    random = np.random.default_rng(2)
    for _ in range(20):
        A, B = Rotation.random(2, random)
        matrices = [np.ascontiguousarray(x.as_matrix()) for x in (A, B)]
        np.testing.assert_allclose(relative_rotation(*matrices), (B * A.inv()).as_rotvec(), atol=1e-12)


@pytest.mark.parametrize("reach", [0.8, 7.0, 100.0, 1e6])
def test_sine_and_cosine_are_within_1e_15_of_libm(reach):
    octants = np.arange(-40, 41) * (math.pi / 4)
    near = [np.nextafter(octants, -np.inf), octants, np.nextafter(octants, np.inf)]
    for x in np.concatenate([np.linspace(-reach, reach, 4001), *near]):
        s, c = sincos(float(x))
        assert abs(s - math.sin(x)) <= 1e-15
        assert abs(c - math.cos(x)) <= 1e-15


NUMBERS = [*np.geomspace(1e-4, 1e5, 400).tolist(), 1.0, 0.011, 0.0101, 9.91, 99.9, 1234.0]


@pytest.mark.parametrize("digits", [1, 2, 3])
def test_rounding_up_and_down_gives_the_next_number_of_n_digits(digits):
    for x in NUMBERS:
        above, below = raised(x, digits), lowered(x, digits)
        assert below <= x * (1 + 1e-9)
        assert above >= x * (1 - 1e-9)
        for each in (above, below):
            assert float(f"{each:.{digits - 1}e}") == each
        assert above - below <= 1.001 * 10.0 ** (np.floor(np.log10(x)) - digits + 1)


OMEGA = np.geomspace(0.1, 1e3, 40)
S = 1j * OMEGA


def first_order(pole: float, gain: float = 1.0) -> LinearSystem:
    return LinearSystem(np.array([[-pole]]), np.array([[1.0]]), np.array([[gain * pole]]), np.zeros((1, 1)))


def test_lags_in_series_and_in_parallel_agree_with_textbooks():
    slow, fast = first_order(5.0, 2.0), first_order(30.0)
    series = slow.after(fast).response(OMEGA)[:, 0, 0]
    assert series == pytest.approx(300.0 / ((S + 5.0) * (S + 30.0)), rel=1e-12)
    G = slow.beside(static(np.array([[3.0]]))).response(OMEGA)
    assert G[:, 0, 0] == pytest.approx(10.0 / (S + 5.0), rel=1e-12)
    assert (G[:, 1, 1] == 3.0).all()
    assert not G[:, [0, 1], [1, 0]].any()


def test_closed_loop_with_feed_through_has_the_textbook_sensitivity():
    P = first_order(5.0)._replace(D=np.array([[0.5]]))
    # z = y = P u + w, seen by the controller
    generalised = LinearSystem(
        P.A, np.hstack([0 * P.B, P.B]), np.vstack([P.C, P.C]), np.array([[1.0, 0.5], [1.0, 0.5]])
    )
    K = first_order(40.0, -7.0)._replace(D=np.array([[-2.0]]))
    loop = P.response(OMEGA)[:, 0, 0] * K.response(OMEGA)[:, 0, 0]
    assert generalised.closed_with(K).response(OMEGA)[:, 0, 0] == pytest.approx(1.0 / (1.0 - loop), rel=1e-10)


def test_an_ill_posed_loop_is_refused():
    with pytest.raises(ModelError, match="well posed"):
        static(np.ones((2, 2))).closed_with(static(np.array([[1.0]])))


def test_a_sampled_double_integrator_agrees_with_textbooks():
    T = 0.01
    P = LinearSystem(
        np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), np.eye(1, 2), np.zeros((1, 1))
    )
    sampled = P.sampled(T)
    z = np.exp(1j * OMEGA[OMEGA < 300] * T)
    expected = 0.5 * T**2 * (z + 1) / (z - 1) ** 2
    assert sampled.response(OMEGA[OMEGA < 300])[:, 0, 0] == pytest.approx(expected, rel=1e-9)
    assert not sampled.is_stable()
    with pytest.raises(ModelError, match="sample periods"):
        sampled.after(P)


def test_stability_of_a_system_means_poles_in_the_left_half_plane_or_unit_circle():
    assert first_order(5.0).is_stable()
    assert first_order(5.0).sampled(0.1).is_stable()
    assert not first_order(-5.0).is_stable()
    assert not first_order(-5.0).sampled(0.1).is_stable()
