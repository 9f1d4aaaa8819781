"""The parts of the verifier, each against an independent result."""

import runpy
import signal
import time
from pathlib import Path

import pytest
import sympy as sp
from flint import arb

from drivers.errors import ModelError
from hil.proof import verify
from hil.proof.branch_and_bound import Budget
from hil.proof.cancellation import cancelled, continuous, lie_derivative
from hil.proof.interval import Enclosure
from hil.proof.level import largest_level
from hil.proof.origin import definite_near, weights_of
from hil.proof.signs import NOWHERE, Signs
from hil.proof.system import make_system
from hil.proof.tail import definite_far

x, y = sp.symbols("x y", real=True)
R = sp.Rational
EXAMPLE = Path(__file__).parents[3] / "docs/examples/lyapunov_picture.py"


class _Spins:
    """An object with a slow finalizer, in which Python ignores exceptions."""

    def __del__(self):
        end = time.monotonic() + 0.1
        while time.monotonic() < end:
            pass


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_the_time_limit_holds_although_a_finalizer_ignores_the_alarm():
    began = time.monotonic()

    def question():
        _Spins()
        while time.monotonic() < began + 5.0:
            pass
        return "too late"

    budget = Budget(seconds=0.05)
    budget.start()
    assert budget.within(1.0, question, "the time ended") == "the time ended"
    assert budget.ended
    assert time.monotonic() < began + 3.0


def test_an_alarm_after_the_answer_keeps_the_answer(monkeypatch):
    before, setitimer = signal.getsignal(signal.SIGALRM), signal.setitimer

    def late(which, seconds, interval=0.0):
        if seconds == 0.0:
            signal.raise_signal(signal.SIGALRM)
        return setitimer(which, seconds, interval)

    monkeypatch.setattr(signal, "setitimer", late)
    budget = Budget(seconds=5.0)
    budget.start()
    assert budget.within(1.0, lambda: "answer", "the time ended") == "answer"
    assert signal.getsignal(signal.SIGALRM) is before
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def signs(box=None):
    return Signs(make_system({x: -x, y: -y}, None, None, box, None), Budget())


SMOOTH = [x**2 - y, x**3 * y, sp.sin(x) * y, sp.Abs(x) ** R(3, 2), sp.exp(-x) / (2 + y), sp.tanh(x - y)]


@pytest.mark.parametrize("e", [*SMOOTH, x**-2 + y])
def test_an_enclosure_contains_the_value_at_every_point(e):
    box = Enclosure(e, (x, y)).on(((0.25, 1.5), (-1.0, 0.5)))
    for a in (R(1, 4), R(7, 10), R(3, 2)):
        for b in (-1, R(-1, 3), R(1, 2)):
            assert box.contains(arb(str(sp.N(e.subs({x: a, y: b}), 30))).mid())


def test_exact_cancellation_gives_the_textbook_derivative():
    v, m, b = x, sp.Symbol("m", positive=True), sp.Symbol("b", positive=True)
    k = sp.Symbol("k", positive=True)
    field = {y: v, v: -(b * v * sp.Abs(v) + k * y) / m}
    assert sp.expand(lie_derivative(m * v**2 / 2 + k * y**2 / 2, field) + b * v**2 * sp.Abs(v)) == 0
    assert cancelled((x**2 - 1) / (x - 1) - x - 1) == 0
    assert cancelled(x * sp.sin(y) ** 2 + x * sp.cos(y) ** 2 - x) == 0


def test_function_with_a_jump_is_refused_and_with_a_kink_accepted():
    assert continuous(sp.diff(sp.Abs(x) ** 3, x)) == 3 * x * sp.Abs(x)
    assert continuous(x * sp.sign(x)) == sp.Abs(x)
    assert continuous(x * sp.sign(x) ** 2) == x
    for jump in (sp.sign(x), sp.sign(x) ** 2, (1 + x) * sp.sign(x), sp.sign(x - y) * y, sp.exp(sp.sign(x))):
        with pytest.raises(ModelError, match=r"continuous|jumps"):
            continuous(jump)


def test_the_lowest_order_form_proves_a_minimum_at_the_origin():
    assert definite_near(1 - sp.cos(x) + y**2, (x, y), {}, Budget())
    assert weights_of(y**2 + x**4, (x, y)) == (1, 2)
    assert definite_near(y**2 + x**4 - x**2 * y, (x, y), {}, Budget())
    assert definite_near(y**2 + x**4 - 2 * x**2 * y, (x, y), {}, Budget()) is None  # (y - x^2)^2
    assert definite_near(x**2 - y**2, (x, y), {}, Budget()) is None
    assert definite_near(x**3, (x,), {}, Budget()) is None
    assert definite_near(x - sp.sin(x), (x,), {}, Budget(), side=1)  # x^3 / 6
    assert definite_near(sp.Abs(x) ** 3 + y**2, (x, y), {}, Budget())
    assert definite_near(sp.sqrt(1 + x**2) - 1, (x,), {}, Budget())
    assert definite_near(sp.sqrt(sp.Abs(x)), (x,), {}, Budget()) is None


def test_tail_bound_gives_a_radius_beyond_which_a_function_is_positive():
    radii = definite_far(x**2 - 100 * x * sp.sin(x), (x,), {}, Budget())
    assert radii is not None
    assert 100 <= radii[0] <= 1024
    assert definite_far(x**4 + y**2 - 10 * x**2, (x, y), {}, Budget())
    for g in (x**2 - x**4, x**2 * y**2 + 1, sp.cos(x) + 2, x**2 / (1 + x**2), x**2 - 2 * x * y + y**2):
        assert definite_far(g, tuple(sorted(g.free_symbols, key=str)), {}, Budget()) is None


def test_zeros_of_semidefinite_functions_are_found():
    s = signs()
    assert s.nonnegative(x**2) == ((x,),)
    assert s.nonnegative(x**2 * (2 + sp.sin(y))) == ((x,),)
    assert s.nonnegative(sp.expand((x + y) ** 2)) == ((x + y,),)
    assert s.nonnegative(1 + x**2) == NOWHERE
    assert s.nonnegative(x * sp.tanh(x)) == ((x,),)
    assert s.nonnegative(x * sp.tanh(y)) is None
    assert s.nonnegative(x * y) is None
    assert s.nonnegative(x**2 - y**4) is None
    assert not s.definite(x**2 - x**4)


@pytest.mark.parametrize("direction", [1, -1])
def test_taylor_remainder_evaluates_powers_and_derivatives_at_the_same_point(direction):
    """x^2 / 10 - 200 x^3 / 3 + ... is positive only up to x = 0.0015. Powers at x, next to a second derivative at
    another point, would seem to be positive up to 0.06.
    """
    at = direction * x
    e = at**2 - 100 * at**3 - R(9, 5) * (1 - sp.cos(at)) + R(100, 3) * sp.sin(at) ** 3
    assert sp.N(e.subs(x, direction * R(16, 10**4))) < 0
    near = definite_near(e, (x,), {}, Budget())
    assert near is not None
    assert near[0][0][1] < 0.0015


def test_largest_level_of_a_function_is_its_smallest_value_on_the_box_boundary():
    box = {x: (-1, 1), y: (-2, 3)}
    assert largest_level(x**2 + y**2, signs(box)) == 1
    level = largest_level(x**2 + x * y + y**2, signs({x: (-1, 1), y: (-5, 5)}))
    assert level is not None
    assert 0.98 * 3 / 4 < level <= R(3, 4)


def test_documentation_example_draws_the_proof_of_a_system_of_two_states(tmp_path):
    example = runpy.run_path(str(EXAMPLE))
    v = sp.Symbol("v")
    f, V, box = {x: v, v: -v - sp.sin(x)}, 1 - sp.cos(x) + v**2 / 2, {x: (-3, 3), v: (-3, 3)}
    picture = example["draw"](f, V, box, tmp_path / "pendulum.png", verify(f, V, box=box))
    assert picture.read_bytes()[:4] == b"\x89PNG"
