"""Code that feeds the cycle multiplies without BLAS, whose kernels round differently on each CPU type."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

HIL = Path(__file__).parents[2] / "hil"
FEEDS_THE_CYCLE = sorted(
    [
        *(HIL / "control").glob("*.py"),
        *(HIL / "estimation").glob("*.py"),
        *(HIL / "mathematics" / name for name in ("rotations.py", "trigonometry.py", "vectors.py")),
        *(HIL / "robot" / name for name in ("inertia.py", "joints.py")),
        *(HIL / "safety").glob("*.py"),
        *(HIL / "loop" / name for name in ("cycle.py", "motion.py", "reference.py")),
        HIL / "design/stability/monitor.py",
        HIL / "design/stability/error_dynamics.py",
        HIL / "app/configuration/platform.py",
    ]
)
PRODUCTS = {"dot", "vdot", "inner", "matmul", "einsum", "tensordot", "linalg"}
# hil.robot.dynamics and hil.trajectory also hold what never reaches the cycle: energies, and checks that only refuse.
ALLOWED = {"inertia.py": {"linalg"}}


def products(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
            found.add("@")
        if isinstance(node, ast.Attribute) and node.attr in PRODUCTS:
            found.add(node.attr)
    return found


@pytest.mark.parametrize("path", FEEDS_THE_CYCLE, ids=lambda p: p.relative_to(HIL).as_posix())
def test_no_matrix_product_of_numpy_feeds_the_cycle(path):
    assert products(path) <= ALLOWED.get(path.name, set())


def test_model_constants_are_packed_without_a_numpy_matrix_product():
    tree = ast.parse((HIL / "robot/dynamics.py").read_text())
    pack = next(n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef) and n.name == "pack_constants")
    assert not any(isinstance(n, ast.MatMult) for n in ast.walk(pack))
    assert not any(isinstance(n, ast.Attribute) and n.attr in PRODUCTS for n in ast.walk(pack))
