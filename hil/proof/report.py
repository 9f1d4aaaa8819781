"""Report of the verifier: one finding on V, another on the equilibrium.

A V that proves nothing says nothing about the system, so the two findings are independent.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Any

import sympy as sp

from hil.proof.linearisation import Eigenvalues
from hil.proof.system import Interval, Point

Box = dict[sp.Symbol, Interval]


class Truth(Enum):
    """Status of a claim after the attempt to prove and to refute it."""

    PROVEN = "proven"
    REFUTED = "refuted"
    UNDECIDED = "undecided"


class Certificate(Enum):
    """Status of the claim that V is a Lyapunov function on the box."""

    VALID = "valid"
    NOT_POSITIVE_DEFINITE = "not positive definite"
    GROWS = "dV/dt > 0"
    UNDECIDED = "undecided"
    NONE = "no V was given"


class Decrease(Enum):
    """Proven decrease of V along the trajectories."""

    STRICT = "dV/dt < 0 except at the equilibrium"
    WEAK = "dV/dt <= 0"
    CONSERVED = "dV/dt = 0"


class Equilibrium(Enum):
    """Proven stability of the equilibrium."""

    STABLE = "stable"
    ASYMPTOTICALLY_STABLE = "asymptotically stable"
    GLOBALLY_ASYMPTOTICALLY_STABLE = "globally asymptotically stable"
    UNSTABLE = "unstable"
    NO_CONCLUSION = "no conclusion"


@dataclass(frozen=True)
class CertificateFinding:
    """Whether V is a Lyapunov function, and why, in the user's symbols and coordinates."""

    status: Certificate
    V_dot: sp.Expr | None = None
    """dV/dt along the trajectories, simplified."""
    decrease: Decrease | None = None
    """Proven decrease of V, if V is valid."""
    at: Point | None = None
    """Counterexample, if any: values of all states and parameters."""
    value: sp.Expr | None = None
    """Value of V, or of dV/dt, at the counterexample."""
    reason: str = ""
    V: sp.Expr | None = None
    """V as proposed by the verifier, if none was given."""

    @property
    def truth(self) -> Truth:
        """Status of the claim that V is valid."""
        refuted = {Certificate.NOT_POSITIVE_DEFINITE, Certificate.GROWS}
        proven = self.status is Certificate.VALID
        return Truth.PROVEN if proven else Truth.REFUTED if self.status in refuted else Truth.UNDECIDED


@dataclass(frozen=True)
class EquilibriumFinding:
    """What is proven about the equilibrium, and how, in the user's symbols and coordinates."""

    status: Equilibrium
    by: str
    """Name of the theorem, and its premise."""
    asymptotic: Truth
    """Status of asymptotic stability; refuted if the equilibrium is unstable or only stable."""
    box: Box | None = None
    """Box of the certificate behind the finding; None: the whole space, or no certificate was needed."""
    level: sp.Expr | None = None
    """The part of {V < level} within the box is invariant. If the equilibrium is asymptotically
    stable, all trajectories in it tend to the equilibrium.
    """


@dataclass(frozen=True)
class Report:
    """Result of the verifier: the findings on V, the equilibrium, and its linearisation, which needs no V."""

    certificate: CertificateFinding
    equilibrium: EquilibriumFinding
    linearisation: Eigenvalues
    parameters: Box
    """Ranges of the parameters for which the report holds; (0, oo) means any positive number."""
    boxes: int
    """Number of cells that the proof took."""

    def figures(self) -> dict[str, Any]:
        """Report as plain values for JSON, expressions as text; `success`: V is a valid Lyapunov function."""
        c, e = self.certificate, self.equilibrium
        return {
            "kind": "proof",
            "success": c.status is Certificate.VALID,
            "certificate": c.status.value,
            "proposed_V": c.V and str(c.V),
            "V_dot": None if c.V_dot is None else str(c.V_dot),
            "decrease": c.decrease and c.decrease.value,
            "counterexample": c.at and {str(x): str(value) for x, value in c.at.items()},
            "reason": c.reason,
            "equilibrium": e.status.value,
            "by": e.by,
            "asymptotic_stability": e.asymptotic.value,
            "box": None if e.box is None else _sides(e.box),
            "level": None if e.level is None else str(e.level),
            "linearisation": self.linearisation.value,
            "parameters": _sides(self.parameters),
            "boxes": self.boxes,
        }

    def __str__(self) -> str:
        c, e = self.certificate, self.equilibrium
        there = "dV/dt" if c.status is Certificate.GROWS else "V"
        where = "" if c.at is None else " at " + ", ".join(f"{x} = {value}" for x, value in c.at.items())
        still = e.asymptotic is Truth.REFUTED and e.status is not Equilibrium.UNSTABLE
        tends = "" if e.asymptotic is not Truth.PROVEN else ", its trajectories tend to the equilibrium"
        lines = {
            f"certificate: {c.status.value}{where}": True,
            f"  V = {c.V}, proposed from the linearisation": c.V is not None,
            f"  dV/dt = {c.V_dot}": c.V_dot is not None,
            f"  there {there} = {c.value}": c.value is not None,
            f"  {c.decrease and c.decrease.value}": c.decrease,
            f"  {c.reason}": c.reason,
            f"equilibrium: {e.status.value}" + f", {e.by}" * bool(e.by): True,
            "  asymptotic stability: refuted": still,
            f"  shown for {_ranges(e.box or {})}": e.box is not None,
            f"  {{V < {e.level}}} within this box is invariant{tends}": e.level is not None,
            f"linearisation: {self.linearisation.value}": True,
            f"for all {_ranges(self.parameters)}": self.parameters,
        }
        return "\n".join(line for line, applies in lines.items() if applies)


def _sides(box: Box) -> dict[str, list[str]]:
    return {str(x): [str(end) for end in side] for x, side in box.items()}


def _ranges(box: Box) -> str:
    """Ranges as text; without an upper end all positive numbers."""
    sides = box.items()
    return ", ".join(
        f"{x} > 0" if (low, high) == (0, sp.oo) else f"{x} in [{low}, {high}]" for x, (low, high) in sides
    )
