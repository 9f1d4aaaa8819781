"""Hand-written linear algebra and rotations against LAPACK and SciPy; the same bits on other library variants."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hil.mathematics.linear_algebra import condition_kernel, solve, solve_transposed
from hil.mathematics.rotations import rotation_from_vector, rotation_motion_kernel, rotation_vector

DATA = Path(__file__).parents[1] / "data"
VECTOR = st.lists(st.floats(-1.7, 1.7), min_size=3, max_size=3).map(np.array)


def test_solve_agrees_with_lapack():
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


def test_condition_is_an_upper_bound_and_at_most_a_quarter_high():
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


def test_half_turns_and_no_turn():
    for axis in np.vstack([np.eye(3), [[0.6, 0.8, 0.0], [-0.6, 0.0, 0.8]]]):
        R = 2 * np.outer(axis, axis) - np.eye(3)
        r = rotation_vector(R)
        assert np.linalg.norm(r) == pytest.approx(np.pi, abs=1e-15)
        assert np.abs(np.cross(r, axis)).max() <= 1e-15
    assert np.array_equal(rotation_vector(np.eye(3)), np.zeros(3))


@given(VECTOR, VECTOR, VECTOR)
@settings(max_examples=50)
def test_motion_of_a_rotation_vector_by_differences(r, dr, ddr):
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
def test_the_same_bits_under_other_blas_and_libm_variants():
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
