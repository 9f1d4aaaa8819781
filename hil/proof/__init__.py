"""Verifier of Lyapunov functions: what V proves about dx/dt = f(x), and the stability of its equilibrium.

Proofs use exact algebra and interval arithmetic. Samples, floating point and solver tolerances prove nothing.
A claim without a proof or counterexample is undecided.

::

    expressions        input, and decimal numbers      signs           definite, semidefinite, positive
    system             the problem in exact form       origin, tail    near the equilibrium and far away
    branch_and_bound   cells and seconds               quadratic       forms; Hessians on a box
    cancellation       dV/dt, exactly                  lasalle, level  where dV/dt = 0; sublevel sets
    interval           enclosures                      linearisation   eigenvalues, a V
    counterexample     points that refute a claim      chetaev         instability
    theorems, report   conclusions
"""

from hil.proof.branch_and_bound import Budget
from hil.proof.report import Certificate, Decrease, Equilibrium, Report, Truth
from hil.proof.theorems import verify

__all__ = ["Budget", "Certificate", "Decrease", "Equilibrium", "Report", "Truth", "verify"]
