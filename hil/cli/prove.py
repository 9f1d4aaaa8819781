"""The command `hil prove`: its options and help text."""

from pathlib import Path

import click

from hil.cli.shared import FILE, finish_lines, reporting, status


@click.command()
@click.argument("file", type=FILE)
@reporting
def command(file: Path) -> None:
    """Prove the stability of an equilibrium of dx/dt = f(x) by a Lyapunov function.

    FILE is YAML: the states with their derivatives, the candidate V, and the ranges of the states for which
    it is claimed. Without V, a candidate is proposed. Symbols that are not states are parameters: any
    positive number, or any number of the range given. A claim is proven, refuted with a counterexample, or
    undecided. Proofs use neither samples nor floating point.

    \b
    A pendulum with damping d:
      kind: proof
      states: {theta: omega, omega: -d * omega - sin(theta)}
      V: 1 - cos(theta) + omega**2 / 2
      box: {theta: [-pi, pi], omega: [-3, 3]}
      parameters: {d: [0.1, 2]}

    \b
    Examples:
      hil prove pendulum.yaml
      hil prove pendulum.yaml --json proof.json

    Exit code 1: V is refuted or undecided. Guide: docs/theory/verifier.md.
    """
    from hil.app.configuration.section_file import read_section
    from hil.proof.question import Question

    question, _ = read_section(file, Question)
    with status("proving"):
        report = question.answer()
    finish_lines(str(report).splitlines(), report.figures())
