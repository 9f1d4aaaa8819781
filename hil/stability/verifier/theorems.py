"""The theorems of section 6.0, each with its conditions.

Here no sign is decided (see signs); a finding names the theorem that it rests on.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import sympy as sp

from drivers.errors import ModelError
from hil.stability.verifier import chetaev, counterexample, lasalle, tail
from hil.stability.verifier.branch_and_bound import Budget
from hil.stability.verifier.cancellation import lie_derivative
from hil.stability.verifier.interval import unsupported
from hil.stability.verifier.level import largest_level
from hil.stability.verifier.linearisation import Eigenvalues, eigenvalues, jacobian
from hil.stability.verifier.report import (
    Certificate,
    CertificateFinding,
    Decrease,
    Equilibrium,
    EquilibriumFinding,
    Report,
    Truth,
)
from hil.stability.verifier.signs import Signs, Zeros, regular
from hil.stability.verifier.system import System, make_system

SHRINKS = 6
"""How often the box is halved in search of one on which V is valid: stability is a local property."""
ROUNDED = "quotients of decimal numbers are rounded and do not cancel: write them as sympy.Rational"


def verify(
    f: Mapping[sp.Symbol, Any],
    V: Any = None,
    *,
    at: Mapping[sp.Symbol, Any] | None = None,
    box: Mapping[sp.Symbol, tuple[Any, Any]] | None = None,
    parameters: Mapping[sp.Symbol, tuple[Any, Any]] | None = None,
    budget: Budget | None = None,
) -> Report:
    """Return what V proves about dx/dt = f(x), and what is known of its equilibrium.

    `f` maps each state to its time derivative, `V` is the Lyapunov candidate (without it only instability
    and the linearisation are looked at), both in sympy. `at` is the equilibrium, the origin where it
    names nothing. `box` says where V is claimed, a state that it does not name is unbounded; without a
    box V is claimed on the whole space, and the finding may be global. Symbols that are not states are
    parameters: any positive number, or one of the range that `parameters` gives. `budget` is how many
    cells may be looked at.

    Sources: section 6.0 of the chapter; Khalil, Nonlinear Systems, theorems 4.1 to 4.4 and 4.7.

    Raises ModelError where the question has no meaning: no equilibrium, f jumps, an unknown function or
    name, a bad box, a symbol that was declared to be less than what is claimed.
    """
    budget = Budget() if budget is None else budget
    start = budget.left
    system = make_system(f, V, at, box, parameters)
    signs = Signs(system, budget)
    near = Signs(system.within(_scaled(system, 2.0**-SHRINKS)), budget)
    spectrum = _spectrum(near)
    claim = None if V is None else system.read(V)
    proof, certificate = _certificate(claim, signs)
    if certificate.status is Certificate.UNDECIDED and any(_decimal(e) for e in (*f.values(), V)):
        certificate = replace(certificate, reason=f"{certificate.reason}; {ROUNDED}")
    equilibrium = _equilibrium(claim, signs, near, proof, spectrum)
    return Report(certificate, equilibrium, spectrum, system.parameters, start - budget.left)


def _decimal(e: Any) -> bool:
    return bool(sp.sympify(0 if e is None else e).has(sp.Float))


@dataclass(frozen=True)
class _Proof:
    """V is positive definite, dV/dt <= 0, on the domain of `signs`; `zeros` of dV/dt."""

    V: sp.Expr
    decrease: Decrease
    zeros: Zeros
    signs: Signs


def _certificate(V: sp.Expr | None, signs: Signs) -> tuple[_Proof | None, CertificateFinding]:
    """Lyapunov's conditions on the domain (6.0, local and global theorem)."""
    if V is None:
        return None, CertificateFinding(Certificate.NONE)
    system = signs.system
    origin = dict.fromkeys(system.states, sp.S.Zero)
    if wrong := unsupported(V):
        return None, _undecided(f"V holds {', '.join(sorted(wrong))}, of which no enclosure is known")
    at_origin = sp.simplify(V.subs(origin))
    if at_origin != 0:
        if not (at_origin.is_finite is False or signs.positive(at_origin) or signs.positive(-at_origin)):
            return None, _undecided(f"V(0) = {at_origin} is not shown to be 0")
        at, refuted = system.in_own_symbols(origin), Certificate.NOT_POSITIVE_DEFINITE
        return None, CertificateFinding(refuted, at=at, value=at_origin, reason="V(0) must be 0")
    if not regular(system.f, signs) or not regular({system.states[0]: V}, signs):
        return None, _undecided("f or V is not shown to be finite and locally Lipschitz on the whole box")
    V_dot, why = None, ""
    try:
        V_dot = lie_derivative(V, system.f)
    except ModelError as error:
        why = f"V is not shown to be continuously differentiable: {error}"
    shown = None if V_dot is None else system.shown(V_dot)
    if (point := counterexample.not_above_zero(V, signs)) is not None:
        at, refuted = system.in_own_symbols(point), Certificate.NOT_POSITIVE_DEFINITE
        return None, CertificateFinding(refuted, shown, None, at, V.subs(point), "V must be > 0 there")
    if V_dot is None:
        return None, _undecided(why)
    if (point := counterexample.above_zero(V_dot, signs)) is not None:
        return None, CertificateFinding(
            Certificate.GROWS, shown, None, system.in_own_symbols(point), V_dot.subs(point)
        )
    if set(signs.own(V)) != set(system.states) or not signs.definite(V):
        return None, replace(_undecided(_why(signs, "V is not shown to be positive definite")), V_dot=shown)
    fall = sp.expand(-V_dot)
    zeros = signs.nonnegative(fall)
    strict = set(signs.own(fall)) == set(system.states) and signs.definite(fall)
    if zeros is None and not strict:
        return None, replace(_undecided(_why(signs, "dV/dt <= 0 is not shown")), V_dot=shown)
    decrease = Decrease.CONSERVED if V_dot == 0 else Decrease.STRICT if strict else Decrease.WEAK
    proof = _Proof(V, decrease, zeros or (), signs)
    return proof, CertificateFinding(Certificate.VALID, shown, decrease)


def _undecided(reason: str) -> CertificateFinding:
    return CertificateFinding(Certificate.UNDECIDED, reason=reason)


def _why(signs: Signs, what: str) -> str:
    return f"{what}: the budget ended" if signs.budget.ended else what


def _equilibrium(
    V: sp.Expr | None, signs: Signs, near: Signs, proof: _Proof | None, spectrum: Eigenvalues
) -> EquilibriumFinding:
    """Return the strongest of what is shown; of stability by V, of instability by eigenvalue or Chetaev."""
    if spectrum is Eigenvalues.RIGHT:
        return EquilibriumFinding(
            Equilibrium.UNSTABLE, "by an eigenvalue with positive real part", Truth.REFUTED
        )
    if proof is None and (W := _growing(V, near)) is not None:
        by = f"by Chetaev's theorem with {signs.system.shown(W)}"
        return EquilibriumFinding(Equilibrium.UNSTABLE, by, Truth.REFUTED)
    if proof is None and V is not None and _stable_in_reversed_time(V, near):
        by = "by LaSalle's theorem in reversed time: what tends to the equilibrium there leaves it"
        return EquilibriumFinding(Equilibrium.UNSTABLE, by, Truth.REFUTED)
    if V is None and spectrum is Eigenvalues.LEFT:
        by = "by the linearisation (Lyapunov's indirect method)"
        return EquilibriumFinding(Equilibrium.ASYMPTOTICALLY_STABLE, by, Truth.PROVEN)
    best = None if proof is None else _stability(proof)
    if V is not None and (best is None or best.asymptotic is Truth.UNDECIDED):
        best = _on_smaller_boxes(V, signs, best)
    if best is None:
        best = EquilibriumFinding(Equilibrium.NO_CONCLUSION, "", Truth.UNDECIDED)
    if best.asymptotic is Truth.UNDECIDED and _rests_nearby(signs.system):
        best = replace(best, asymptotic=Truth.REFUTED)
    return best


def _growing(V: sp.Expr | None, near: Signs) -> sp.Expr | None:
    return chetaev.function(V, near) if regular(near.system.f, near) else None


def _stable_in_reversed_time(V: sp.Expr, near: Signs) -> bool:
    """Krasovskii's instability theorem: V > 0 and dV/dt >= 0, which is zero along no trajectory."""
    system = near.system
    back = Signs(replace(system, f={x: sp.expand(-e) for x, e in system.f.items()}), near.budget)
    proof, _ = _certificate(V, back)
    return proof is not None and _stability(proof).asymptotic is Truth.PROVEN


def _stability(proof: _Proof) -> EquilibriumFinding:
    """Lyapunov's and LaSalle's theorems on the domain of the proof."""
    signs, system = proof.signs, proof.signs.system
    box = None if _whole_space(system) else _own_box(system)
    level = largest_level(proof.V, signs)
    if proof.decrease is Decrease.CONSERVED:
        by = "by Lyapunov's theorem; V stays what it is, so nothing else tends to the equilibrium"
        return EquilibriumFinding(Equilibrium.STABLE, by, Truth.REFUTED, box, level)
    theorem = "Lyapunov's" if proof.decrease is Decrease.STRICT else "LaSalle's"
    if proof.decrease is Decrease.STRICT or lasalle.leaves(proof.zeros, signs):
        if _whole_space(system) and _grows_without_bound(proof.V, signs):
            by = f"by {theorem} theorem, V being radially unbounded"
            return EquilibriumFinding(Equilibrium.GLOBALLY_ASYMPTOTICALLY_STABLE, by, Truth.PROVEN)
        kind = Equilibrium.ASYMPTOTICALLY_STABLE
        return EquilibriumFinding(kind, f"by {theorem} theorem", Truth.PROVEN, box, level)
    return EquilibriumFinding(Equilibrium.STABLE, "by Lyapunov's theorem", Truth.UNDECIDED, box, level)


def _on_smaller_boxes(V: sp.Expr, signs: Signs, best: EquilibriumFinding | None) -> EquilibriumFinding | None:
    for k in range(0 if not signs.system.bounded else 1, SHRINKS + 1):
        smaller = Signs(signs.system.within(_scaled(signs.system, 2.0**-k)), signs.budget)
        proof, certificate = _certificate(V, smaller)
        if proof is not None:
            found = _stability(proof)
            if found.asymptotic is not Truth.UNDECIDED:
                return found
            best = best or found
        elif certificate.at is not None and not any(certificate.at.values()):
            return best
    return best


def _scaled(system: System, share: float) -> dict[sp.Symbol, tuple[sp.Expr, sp.Expr]]:
    s = sp.Rational(share)
    return {
        x: (-s if low == -sp.oo else low * s, s if high == sp.oo else high * s)
        for x, (low, high) in system.domain.items()
    }


def _own_box(system: System) -> dict[sp.Symbol, tuple[sp.Expr, sp.Expr]]:
    own, centre = system.own, system.equilibrium
    return {own[x]: (low + centre[own[x]], high + centre[own[x]]) for x, (low, high) in system.domain.items()}


def _whole_space(system: System) -> bool:
    return all(side == (-sp.oo, sp.oo) for side in system.domain.values())


def _grows_without_bound(V: sp.Expr, signs: Signs) -> bool:
    """Radial unboundedness: V -> oo as |x| -> oo."""
    if not signs.enclosable(V):
        if signs.own(sp.denom(sp.together(V))):
            return False
        if (V := signs.freed(V)) is None:
            return False
    ranges = {p: signs.sides[p] for p in signs.system.ranges}
    return tail.definite_far(V, signs.system.states, ranges, signs.budget) is not None


def _spectrum(near: Signs) -> Eigenvalues:
    A = jacobian(near.system)
    if A is None or not regular(near.system.f, near):
        return Eigenvalues.UNKNOWN
    return eigenvalues(A, near)


def _rests_nearby(system: System) -> bool:
    """Tell whether a line through the equilibrium consists of equilibria: then nothing on it tends there."""
    s = sp.Dummy("s", real=True)
    A = jacobian(system)
    lines = [[s if x == y else 0 for y in system.states] for x in system.states]
    if A is not None:
        lines += [[s * v for v in vector] for vector in A.nullspace()]
    return any(
        all(sp.expand(e.subs(dict(zip(system.states, line, strict=True)))) == 0 for e in system.f.values())
        for line in lines
    )
