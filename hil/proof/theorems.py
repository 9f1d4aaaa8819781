"""The theorems of section 6.0, each with its conditions.

This module proves no sign itself (see hil.proof.signs); each result states its theorem.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import sympy as sp

from drivers.errors import ModelError
from hil.proof import chetaev, counterexample, lasalle, quadratic, tail
from hil.proof.branch_and_bound import Budget
from hil.proof.cancellation import lie_derivative
from hil.proof.interval import unsupported
from hil.proof.level import largest_level
from hil.proof.linearisation import Eigenvalues, eigenvalues, jacobian, lyapunov_function
from hil.proof.report import (
    Certificate,
    CertificateFinding,
    Decrease,
    Equilibrium,
    EquilibriumFinding,
    Report,
    Truth,
)
from hil.proof.signs import Signs, Zeros, regular
from hil.proof.system import Point, System, make_system

SHRINKS = 6
"""Number of times the box is halved in the search for one on which V is valid; stability is local."""
ROUNDED = (
    "decimal numbers with so many digits count as rounded: they represent every number within their rounding "
    "and may not cancel; write exact numbers as sympy.Rational"
)
_NO_V = CertificateFinding(Certificate.NONE)
_NOTHING = EquilibriumFinding(Equilibrium.NO_CONCLUSION, "", Truth.UNDECIDED)
_INDIRECT = EquilibriumFinding(
    Equilibrium.ASYMPTOTICALLY_STABLE, "by the linearisation (Lyapunov's indirect method)", Truth.PROVEN
)


def verify(
    f: Mapping[sp.Symbol, Any],
    V: Any = None,
    *,
    at: Mapping[sp.Symbol, Any] | None = None,
    box: Mapping[sp.Symbol, tuple[Any, Any]] | None = None,
    parameters: Mapping[sp.Symbol, tuple[Any, Any]] | None = None,
    budget: Budget | None = None,
) -> Report:
    """Prove or refute that V is a Lyapunov function of dx/dt = f(x); find the stability of the equilibrium.

    `f` maps each state to its time derivative, `V` is the Lyapunov candidate, both in SymPy; if omitted, one
    is proposed from the linearisation. `at` is the equilibrium; omitted states are 0. V shall hold on `box`,
    in which omitted states are unbounded. Without a box V shall hold on the whole space, and stability may be
    proven globally. All other symbols are parameters: any positive number, or a number in a range of
    `parameters`. `budget` limits cells and seconds.

    Sources: section 6.0 of the chapter; Khalil, Nonlinear Systems, theorems 4.1 to 4.4 and 4.7.

    Raises ModelError for invalid input: no equilibrium, a discontinuous f, an unknown function or symbol, an
    invalid box, or a symbol declared with a stronger assumption than the claim.
    """
    budget = Budget() if budget is None else budget
    start = budget.left
    budget.start()
    system = budget.within(0.25, lambda: make_system(f, V, at, box, parameters), None)
    if system is None:
        status = Certificate.NONE if V is None else Certificate.UNDECIDED
        late = CertificateFinding(status, reason="the time limit passed while the input was read")
        return Report(late, _NOTHING, Eigenvalues.UNKNOWN, {}, 0)
    claim = None if V is None else system.read(V)
    signs, near = Signs(system, budget), Signs(system.scaled(2.0**-SHRINKS), budget)
    spectrum = budget.within(0.4, lambda: eigenvalues(near), Eigenvalues.UNKNOWN)
    if claim is None and spectrum is Eigenvalues.LEFT:
        certificate, equilibrium = _proposed(signs)
        return Report(certificate, equilibrium, spectrum, system.parameters, start - budget.left)
    late = CertificateFinding(Certificate.UNDECIDED, reason="the time limit passed before a proof was found")
    otherwise: _Shown = (None, late)
    proof, certificate = budget.within(0.65, lambda: _certificate(claim, signs), otherwise)
    if certificate.status is Certificate.UNDECIDED and system.rounded.numbers:
        numbers = ", ".join(map(str, system.rounded.numbers.values()))
        certificate = replace(certificate, reason=f"{certificate.reason}; {numbers}: {ROUNDED}")
    equilibrium = _equilibrium(claim, signs, near, proof, spectrum)
    return Report(certificate, equilibrium, spectrum, system.parameters, start - budget.left)


@dataclass(frozen=True)
class _Proof:
    """Proof that V is positive definite and dV/dt <= 0 on the domain of `signs`; `zeros`: where dV/dt = 0."""

    V: sp.Expr
    decrease: Decrease
    zeros: Zeros
    signs: Signs


_Shown = tuple[_Proof | None, CertificateFinding]


def _certificate(V: sp.Expr | None, signs: Signs) -> _Shown:
    """Check Lyapunov's conditions on V on the domain of `signs` (section 6.0); proof or None, and finding."""
    if V is None:
        return None, _NO_V
    system, shown = signs.system, None

    def undecided(reason: str) -> _Shown:
        return None, CertificateFinding(Certificate.UNDECIDED, shown, reason=reason)

    def refuted(status: Certificate, g: sp.Expr, point: Point, reason: str = "") -> _Shown:
        value = g.subs(point).xreplace(system.rounded.numbers)
        return None, CertificateFinding(status, shown, None, system.in_own_symbols(point), value, reason)

    if wrong := unsupported(V):
        return undecided(f"V contains {', '.join(sorted(wrong))}, which has no known enclosure")
    origin = dict.fromkeys(system.states, sp.S.Zero)
    at_origin = sp.simplify(V.xreplace(origin))
    if at_origin != 0:
        if not (at_origin.is_finite is False or signs.positive(at_origin) or signs.positive(-at_origin)):
            return undecided(f"V(0) = {at_origin} is not shown to be 0")
        return refuted(Certificate.NOT_POSITIVE_DEFINITE, at_origin, origin, "V(0) must be 0")
    if not regular(system.f, signs) or not regular({system.states[0]: V}, signs):
        return undecided("f or V is not shown to be finite and locally Lipschitz on the whole box")
    V_dot, why = None, ""
    try:
        V_dot = lie_derivative(V, system.f)
        shown = system.shown(V_dot)
    except ModelError as error:
        why = f"V is not shown to be continuously differentiable: {error}"
    if (point := counterexample.find(-V, signs, or_zero=True)) is not None:
        return refuted(Certificate.NOT_POSITIVE_DEFINITE, V, point, "V must be > 0 there")
    if V_dot is None:
        return undecided(why)
    if (point := counterexample.find(V_dot, signs)) is not None:
        return refuted(Certificate.GROWS, V_dot, point)
    if set(signs.own(V)) != set(system.states) or not signs.definite(V):
        return undecided(_why(signs, "V is not shown to be positive definite"))
    fall = sp.expand(-V_dot)
    zeros = signs.nonnegative(fall)
    strict = set(signs.own(fall)) == set(system.states) and signs.definite(fall)
    if zeros is None and not strict:
        return undecided(_why(signs, "dV/dt <= 0 is not shown"))
    decrease = Decrease.CONSERVED if V_dot == 0 else Decrease.STRICT if strict else Decrease.WEAK
    proof = _Proof(V, decrease, zeros or (), signs)
    return proof, CertificateFinding(Certificate.VALID, shown, decrease)


def _why(signs: Signs, what: str) -> str:
    return f"{what}: the budget ended" if signs.budget.ended else what


def _equilibrium(
    V: sp.Expr | None, signs: Signs, near: Signs, proof: _Proof | None, spectrum: Eigenvalues
) -> EquilibriumFinding:
    """Strongest proven statement: stability by V, instability by an eigenvalue or Chetaev's theorem."""
    budget = signs.budget
    by = "by an eigenvalue with positive real part" if spectrum is Eigenvalues.RIGHT else None
    if by is None and proof is None:
        by = budget.within(0.8, lambda: _why_unstable(V, near), None)
    if by is not None:
        return EquilibriumFinding(Equilibrium.UNSTABLE, by, Truth.REFUTED)
    best = _NOTHING
    if proof is not None:
        box = _named_box(signs.system)
        best = EquilibriumFinding(Equilibrium.STABLE, "by Lyapunov's theorem", Truth.UNDECIDED, box)
        best = budget.within(0.8, lambda: _stability(proof), best)
    if V is not None and best.asymptotic is Truth.UNDECIDED:
        first = best if proof is not None else None
        best = budget.within(0.95, lambda: _on_smaller_boxes(V, signs, first), None) or best
    if best.asymptotic is Truth.UNDECIDED and budget.within(1.0, lambda: _rests_nearby(near), False):
        best = replace(best, asymptotic=Truth.REFUTED)
    return best


def _why_unstable(V: sp.Expr | None, near: Signs) -> str | None:
    if regular(near.system.f, near) and (W := chetaev.function(V, near)) is not None:
        return f"by Chetaev's theorem with {near.system.shown(W)}"
    if V is not None and _stable_in_reversed_time(V, near):
        return "by LaSalle's theorem in reversed time: trajectories that tend to it in reversed time leave it"
    return None


def _proposed(signs: Signs) -> tuple[CertificateFinding, EquilibriumFinding]:
    """Try the V that the linearisation proposes on the domain, then on smaller boxes."""
    budget = signs.budget
    none: _Shown = (None, _NO_V)
    V = budget.within(0.6, lambda: lyapunov_function(signs.system), None)
    for smaller, share in [(signs, 0.6), *((each, 0.95) for each in _shrunk(signs))] if V is not None else []:
        proof, certificate = budget.within(share, partial(_certificate, V, smaller), none)
        if proof is not None and proof.decrease is Decrease.STRICT:
            equilibrium = budget.within(1.0, partial(_stability, proof), _INDIRECT)
            return replace(certificate, V=smaller.system.shown(V)), equilibrium
    return _NO_V, _INDIRECT


def _stable_in_reversed_time(V: sp.Expr, near: Signs) -> bool:
    """Krasovskii's instability theorem: V > 0 and dV/dt >= 0, which is zero along no trajectory."""
    system = near.system
    back = Signs(replace(system, f={x: sp.expand(-e) for x, e in system.f.items()}), near.budget)
    proof, _ = _certificate(V, back)
    return proof is not None and _stability(proof).asymptotic is Truth.PROVEN


def _stability(proof: _Proof) -> EquilibriumFinding:
    """What Lyapunov's and LaSalle's theorems state on the domain of the proof."""
    signs, system = proof.signs, proof.signs.system
    box = _named_box(system)
    level = largest_level(proof.V, signs)
    if proof.decrease is Decrease.CONSERVED:
        by = "by Lyapunov's theorem; V is conserved, so no other trajectory tends to the equilibrium"
        return EquilibriumFinding(Equilibrium.STABLE, by, Truth.REFUTED, box, level)
    theorem = "Lyapunov's" if proof.decrease is Decrease.STRICT else "LaSalle's"
    if proof.decrease is Decrease.STRICT or lasalle.leaves(proof.zeros, signs):
        if _whole_space(system) and _grows_without_bound(proof.V, signs):
            by = f"by {theorem} theorem with a radially unbounded V"
            return EquilibriumFinding(Equilibrium.GLOBALLY_ASYMPTOTICALLY_STABLE, by, Truth.PROVEN)
        kind = Equilibrium.ASYMPTOTICALLY_STABLE
        return EquilibriumFinding(kind, f"by {theorem} theorem", Truth.PROVEN, box, level)
    return EquilibriumFinding(Equilibrium.STABLE, "by Lyapunov's theorem", Truth.UNDECIDED, box, level)


def _on_smaller_boxes(V: sp.Expr, signs: Signs, best: EquilibriumFinding | None) -> EquilibriumFinding | None:
    for smaller in _shrunk(signs):
        proof, certificate = _certificate(V, smaller)
        if proof is not None:
            found = _stability(proof)
            if found.asymptotic is not Truth.UNDECIDED:
                return found
            best = best or found
        elif certificate.at is not None and not any(certificate.at.values()):
            return best
    return best


def _shrunk(signs: Signs) -> Iterator[Signs]:
    for k in range(int(signs.system.bounded), SHRINKS + 1):
        yield Signs(signs.system.scaled(2.0**-k), signs.budget)


def _named_box(system: System) -> dict[sp.Symbol, tuple[sp.Expr, sp.Expr]] | None:
    if _whole_space(system):
        return None
    own, centre = system.own, system.equilibrium
    return {own[x]: (low + centre[own[x]], high + centre[own[x]]) for x, (low, high) in system.domain.items()}


def _whole_space(system: System) -> bool:
    return all(side == (-sp.oo, sp.oo) for side in system.domain.values())


def _grows_without_bound(V: sp.Expr, signs: Signs) -> bool:
    """Prove that V is radially unbounded, V -> oo as |x| -> oo, as every definite quadratic form is."""
    if quadratic.coefficients(V, signs.system.states) is not None:
        return signs.definite(V)
    if not signs.enclosable(V):
        if signs.own(sp.denom(sp.together(V))):
            return False
        if (V := signs.freed(V)) is None:
            return False
    ranges = {p: signs.sides[p] for p in signs.system.ranges}
    return tail.definite_far(V, signs.system.states, ranges, signs.budget) is not None


def _rests_nearby(signs: Signs) -> bool:
    """True if a line of equilibria through the equilibrium is found, which excludes asymptotic stability."""
    system = signs.system
    s = sp.Dummy("s", real=True)
    A = jacobian(system)
    lines = [[s if x == y else 0 for y in system.states] for x in system.states]
    if A is not None:
        lines += [[s * v for v in vector] for vector in A.nullspace()]
    for line in lines:
        there = dict(zip(system.states, line, strict=True))
        rests = all(sp.cancel(sp.together(sp.expand(e.subs(there)))) == 0 for e in system.f.values())
        # it is a line for all parameters where no denominator vanishes
        if rests and all(signs.sign(sp.denom(sp.together(v))) != 0 for v in line):
            return True
    return False
