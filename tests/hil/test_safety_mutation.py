"""The tests of every safety rule notice any change of the rule.

One operator, number, call or statement in a file of the package is changed, and the tests of that file run
against the changed copy, without compilation. A change that no test notices fails here.
"""

import ast
import importlib.util
import inspect
import itertools
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import hil.safety
from hil.safety.error_axes import error_axes
from tests.hil import encoder_bench, safety_bench
from tests.hil.encoder_bench import Columns
from tools.mutants.mutant import Mutant, equivalents, mutants

PACKAGE = Path(hil.safety.__file__).parent
FAMILIES = ["signals", "motion", "force_limits", "certificate"]

OPERATORS = {
    **dict.fromkeys(
        ("comparison", "arithmetic", "and/or", "not dropped", "truth", "one more", "one less"), ""
    ),
    **dict.fromkeys(("abs dropped", "min/max", "branches"), ""),
    "sign": "^-",
    **dict.fromkeys(("doubled", "halved"), "[.e]"),
    "statement deleted": r"^\S+ [-+*/|&]= ",
}
"""Operators of the tried changes, each with a pattern of the code to change; `make mutants` draws others
at random."""
Mutants = list[tuple[Mutant, ast.Module]]


def plain(source: str) -> ast.Module:
    """Syntax tree of a module without decorators, docstrings and annotations: nothing is compiled."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            kept = {"property", "classmethod"}
            node.decorator_list = [d for d in node.decorator_list if getattr(d, "id", "") in kept]
            node.returns = None
            for argument in node.args.args:
                argument.annotation = None
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            node.body = [
                s for s in node.body if not (isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant))
            ] or [ast.Pass()]
    return ast.fix_missing_locations(tree)


def mutants_of(name: str) -> Mutants:
    """Possible changes of a file of the package, each with the changed syntax tree."""
    file, text = f"hil/safety/{name}.py", (PACKAGE / f"{name}.py").read_text()
    known = equivalents()
    found = [m for m in mutants(file, text) if m.operator in OPERATORS and m.place not in known]
    found = [m for m in found if re.search(OPERATORS[m.operator], m.before)]
    return [(m, plain(m.applied(text))) for m in found]


def load(name: str, tree: ast.Module, links: dict[str, Any]) -> ModuleType:
    """Run a syntax tree as a module; imported names in `links` are replaced."""
    module = ModuleType(name)
    exec(compile(tree, name, "exec"), vars(module))
    own = {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    own |= {ast.unparse(node.targets[0]) for node in tree.body if isinstance(node, ast.Assign)}
    for key in vars(module).keys() & links.keys() - own:
        setattr(module, key, links[key])
    return module


def source_of(name: str) -> ast.Module:
    return plain((PACKAGE / f"{name}.py").read_text())


def plain_links() -> dict[str, Any]:
    """Every function of the package in uncompiled form, and the modules that guard imports."""
    links: dict[str, Any] = {"error_axes": error_axes}
    for name in [*FAMILIES, "residuals", "encoder_rules", "kernels"]:
        module = load(name, source_of(name), links)
        links.update({k: v for k, v in vars(module).items() if inspect.isfunction(v)})
        links[name] = module
    return links | entries(links)


def by_name(function: Callable[..., Any]) -> Callable[..., Any]:
    """Uncompiled kernel that takes records and returns integers."""
    return lambda *given: tuple(map(int, function(*(Columns(x) if x.dtype.names else x for x in given))))


def entries(links: Mapping[str, Any]) -> dict[str, Callable[..., Any]]:
    """The two entry functions of the kernels, uncompiled."""
    return {name: by_name(links[name]) for name in ("judge", "limit")}


def claims(path: str) -> ModuleType:
    """Fresh copy of a test file whose modules under test can be replaced."""
    file = Path(__file__).with_name(path)
    spec = importlib.util.spec_from_file_location(f"claims_{file.stem}", file)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def cases(function: Callable[..., None]) -> Iterator[dict[str, Any]]:
    """Arguments of each case of a parametrised test."""
    axes = []
    for mark in getattr(function, "pytestmark", []):
        names = (
            [n.strip() for n in mark.args[0].split(",")] if isinstance(mark.args[0], str) else mark.args[0]
        )
        axes.append([dict(zip(names, v if len(names) > 1 else (v,), strict=True)) for v in mark.args[1]])
    for combination in itertools.product(*axes):
        yield {k: v for part in combination for k, v in part.items()}


Test = tuple[Callable[..., None], dict[str, Any]]


def claimed(module: ModuleType, prefix: str) -> list[Test]:
    """Tests of a module with a prefix, each with the arguments of one case."""
    named = [function for name, function in vars(module).items() if name.startswith(prefix)]
    return [(function, arguments) for function in named for arguments in cases(function)]


def noticed(tests: list[Test]) -> bool:
    """True if a test fails; it moves to the front, since it is likely to notice the next change, too."""
    for place, (function, arguments) in enumerate(tests):
        try:
            function(**arguments)
        except BaseException as error:
            if not isinstance(error, Exception) and type(error).__name__ != "Failed":  # pytest.fail, raises
                raise
            tests.insert(0, tests.pop(place))
            return True
    return False


def survivors(
    name: str, module: ModuleType, exchange: Callable[[ModuleType], None], prefix: str, left_out: str = " : "
) -> list[str]:
    """Changes that no test notices, of all functions or of those whose text has not `left_out`."""
    links = plain_links()
    tests = claimed(module, prefix)
    exchange(load(name, source_of(name), links))
    assert not noticed(tests), "the tests fail on the unchanged copy"
    left = []
    changed = [each for each in mutants_of(name) if left_out not in str(each[0])]
    for mutant, tree in changed:
        try:
            loaded = load(name, tree, links)
        except Exception:  # noqa: BLE001 - does not even load
            continue
        exchange(loaded)
        if not noticed(tests):
            left.append(str(mutant))
    assert len(changed) >= 2
    return left


@pytest.mark.parametrize("family", FAMILIES)
def test_rule_tests_fail_for_every_mutation_of_their_safety_rule(family):
    module = claims("test_safety_certificate_rules.py" if family == "certificate" else "test_safety_rules.py")
    left = survivors(
        family, module, lambda m: setattr(module, family, m), f"test_{family}_", " limit_effort: "
    )
    assert not left, "\n".join(left)


def test_encoder_tests_fail_for_every_mutation_of_the_residual_rules():
    rules, steps = claims("test_encoder_rules.py"), claims("test_encoder_steps.py")
    vars(rules).update({k: v for k, v in vars(steps).items() if k.startswith("test_residuals_")})

    def exchange(changed: ModuleType) -> None:
        rules.residuals = steps.residuals = changed  # type: ignore[attr-defined]

    left = survivors("residuals", rules, exchange, "test_residuals_")
    assert not left, "\n".join(left)


def whole() -> ModuleType:
    """Tests of the combined rules; the force tests come first, as they notice changes that make other
    tests endless.
    """
    module = claims("test_safety_force.py")
    for path in ("test_safety_certificate.py", "test_safety.py"):
        vars(module).update({k: v for k, v in vars(claims(path)).items() if k.startswith("test_guard_")})
    return module


@pytest.mark.long
def test_guard_tests_fail_for_every_mutation_of_the_combined_kernels(monkeypatch):
    links = plain_links()

    def exchange(kernels: ModuleType) -> None:
        linked = load("guard", source_of("guard"), {**links, **entries(vars(kernels))})
        monkeypatch.setattr(safety_bench, "guard", linked)

    def exchange_limits(changed: ModuleType) -> None:
        functions = {k: v for k, v in vars(changed).items() if inspect.isfunction(v)}
        exchange(load("kernels", source_of("kernels"), {**links, **functions}))

    left = survivors("kernels", whole(), exchange, "test_guard_")
    left += survivors("force_limits", whole(), exchange_limits, "test_guard_", " clamp: ")
    left = [each for each in left if "force_limits" not in each or " limit_effort: " in each]
    assert not left, "\n".join(left)


@pytest.mark.long
def test_encoder_tests_fail_for_every_mutation_of_the_encoder_rules(monkeypatch):
    doubts, motion = claims("test_encoder_kernels.py"), claims("test_encoder_motion.py")
    for other in (motion, claims("test_encoder_answers.py")):
        vars(doubts).update({k: v for k, v in vars(other).items() if k.startswith("test_encoders_")})
    links = plain_links()

    def exchange(changed: ModuleType) -> None:
        functions = {k: v for k, v in vars(changed).items() if inspect.isfunction(v)}
        kernels = load("kernels", source_of("kernels"), {**links, **functions})
        linked = load("guard", source_of("guard"), {**links, **entries(vars(kernels))})
        monkeypatch.setattr(encoder_bench, "guard", linked)
        motion.encoder_rules = changed  # type: ignore[attr-defined]

    left = survivors("encoder_rules", doubts, exchange, "test_encoders_")
    assert not left, "\n".join(left)


@pytest.mark.long
def test_guard_tests_fail_for_every_mutation_of_the_guard(monkeypatch):
    left = survivors("guard", whole(), lambda m: monkeypatch.setattr(safety_bench, "guard", m), "test_guard_")
    assert not left, "\n".join(left)
