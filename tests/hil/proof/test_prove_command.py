"""`hil prove`: input files, findings and errors; text of a file is never executed."""

from __future__ import annotations

import json

import pytest
import sympy as sp
from click.testing import CliRunner

from hil.cli import main
from hil.proof.question import FUNCTIONS, expression

PENDULUM = """
kind: proof
states: {theta: omega, omega: -d * omega - sin(theta)}
V: 1 - cos(theta) + omega**2 / 2
box: {theta: [-pi, pi], omega: [-3, 3]}
parameters: {d: [0.1, 2]}
"""


def prove(folder, text, *options):
    file = folder / "question.yaml"
    file.write_text(text)
    return CliRunner().invoke(main, ["prove", str(file), *map(str, options)])


def test_a_damped_pendulum_is_proven_asymptotically_stable(tmp_path):
    result = prove(tmp_path, PENDULUM, "--json", tmp_path / "proof.json")
    assert result.exit_code == 0, result.output
    assert "asymptotically stable, by LaSalle's theorem" in result.output
    found = json.loads((tmp_path / "proof.json").read_text())
    assert found["certificate"] == "valid"
    assert found["asymptotic_stability"] == "proven"
    assert found["parameters"] == {"d": ["1/10", "2"]}


@pytest.mark.parametrize(
    ("old", "new", "finding"),
    [
        ("-d * omega", "d * omega", "dV/dt > 0"),
        ("omega**2 / 2", "omega / 2", "not positive definite"),
    ],
    ids=["pushed pendulum", "V of both signs"],
)
def test_a_refuted_claim_shows_its_counterexample_and_exits_with_1(tmp_path, old, new, finding):
    result = prove(tmp_path, PENDULUM.replace(old, new), "--json", tmp_path / "proof.json")
    assert result.exit_code == 1
    found = json.loads((tmp_path / "proof.json").read_text())
    assert found["certificate"] == finding
    assert found["counterexample"].keys() >= {"theta", "omega"}


def test_lyapunov_function_is_proposed_if_the_proof_file_has_none(tmp_path):
    result = prove(tmp_path, "kind: proof\nstates: {x: v, v: -x - v + x**3}\n")
    assert result.exit_code == 0
    assert "V = v**2 + v*x + 3*x**2/2, proposed" in result.output


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')", "(1).__class__", "x.args", "x[0]", "[x for x in y]",
        "lambda: x", "x if x else y", "x and y", "x < y", "x = 1", "sin(x, y)", "sin(x=y)", "sin",
        "eval(x)", "x ^ 2", "x // 2", "'x'", "1j", "True", "0x10", "1 / 0", "0 ** -1", "1e999999999",
        "9 ** 9 ** 9", "sqrt(2) ** 1e9", "(2 * x) ** 3e9", "(1e300 * x) ** 10000", "exp(log(2) * 1e12)",
        "e ** (1e9 * log(3))", "sign(sin(exp(1e9)))", "2 ** sqrt(2)", "(9 ** 3000) ** 3000",
        "(" * 3000 + "x" + ")" * 3000, "-" * 3999 + "x", "x +" * 2000 + "x", "", "x\0",
    ],
)  # fmt: skip
def test_expression_outside_the_grammar_of_a_proof_file_is_refused(text):
    with pytest.raises(ValueError, match=r"allowed|divides"):
        expression(text)


def test_problems_of_a_proof_file_are_listed_with_line_and_column(tmp_path):
    result = prove(tmp_path, "kind: proof\nstates: {x: system(x), y: y}\nbox: {x: [0]}\n")
    assert result.exit_code == 2
    assert "question.yaml:2:13: states.x: system(x)" in result.output
    assert ":3:10: box.x" in result.output


def test_an_unknown_state_in_the_box_is_refused(tmp_path):
    result = prove(tmp_path, PENDULUM.replace("box: {theta", "box: {phi"))
    assert result.exit_code == 2
    assert "phi" in result.output


def test_expressions_of_a_proof_file_are_parsed_exactly():
    x, y = sp.symbols("x y")
    assert expression("0.1 * x**2 - y / 3 + 1_000") == x**2 / 10 - y / 3 + 1000
    assert expression("-x**2 + e**-1 * pi") == -(x**2) + sp.pi / sp.E
    for name, function in FUNCTIONS.items():
        assert expression(f"{name}(x)") == function(x)
