"""Size limits of the source: length of files and functions, number of parameters."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("drivers", "hil", "plant_fmu")
FILES = sorted(
    path for package in PACKAGES for end in ("py", "c", "h") for path in (ROOT / package).rglob(f"*.{end}")
)


def functions(root=ROOT):
    """Each function of the packages: its place, its lines, and the names of its parameters."""
    for path in sorted(path for package in PACKAGES for path in (root / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                given = node.args
                every = [*given.posonlyargs, *given.args, given.vararg, *given.kwonlyargs, given.kwarg]
                names = [argument.arg for argument in every if argument is not None]
                where = f"{path.relative_to(root)}:{node.lineno} {node.name}"
                yield where, (node.end_lineno or node.lineno) - node.lineno + 1, names


def test_no_function_has_more_than_twelve_parameters():
    found = {where: len(names) for where, _, names in functions() if len(set(names) - {"self", "cls"}) > 12}
    assert not found


@pytest.mark.parametrize("package", PACKAGES)
def test_no_file_has_more_than_four_hundred_lines(package):
    sizes = {path.relative_to(ROOT): len(path.read_text().splitlines()) for path in FILES}
    found = {str(path): lines for path, lines in sizes.items() if path.parts[0] == package and lines > 400}
    assert not found


def test_at_most_one_function_in_two_hundred_is_longer_than_sixty_lines():
    every = list(functions())
    long = {where: lines for where, lines, _ in every if lines > 60}
    assert len(long) <= 0.005 * len(every), (long, len(every))
