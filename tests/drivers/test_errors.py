"""The tree of errors is drawn as it is."""

import ast
import builtins
import re
from pathlib import Path

from drivers import errors

ROOT = Path(__file__).parents[2]
LINE = re.compile(r"^    ((?:│   )*)(?:[├└]── )?(\w+Error)\b(.*)$")


def drawn():
    """Name, parent and module of each error of the drawing."""
    path: list[str] = []
    for line in (errors.__doc__ or "").splitlines():
        if found := LINE.match(line):
            bars, name, words = found.groups()
            depth = len(bars) // 4 + ("── " in line)
            path = [*path[:depth], name]
            where = re.search(r"\(((?:hil|drivers)[\w.]+)\)$", words)
            if not hasattr(builtins, name):
                yield name, path[-2] if depth else "Exception", where[1] if where else "drivers.errors"


def defined():
    """Name, parent and module of each public class of the three packages that is named an error."""
    for package in ("drivers", "hil", "plant_fmu"):
        for file in (ROOT / package).rglob("*.py"):
            module = ".".join(file.relative_to(ROOT).with_suffix("").parts)
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ClassDef) and re.fullmatch(r"[A-Z]\w*Error", node.name):
                    yield node.name, ast.unparse(node.bases[0]), module


def test_the_drawing_names_each_error_with_its_parent_and_its_module():
    there = sorted(defined())
    assert len(there) == 17
    assert sorted(drawn()) == there
