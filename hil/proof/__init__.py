"""The verifier: given f and V, what V proves, and what is known of the equilibrium.

Proofs are exact algebra and interval arithmetic; nothing is proven by samples, by floating point or by a
solver's tolerance. In doubt a claim is undecided.

::

    door               what is taken, and decimals     signs           definite, semidefinite, positive
    system             the question in exact form      origin, tail    near the equilibrium and far away
    branch_and_bound   cells and seconds               quadratic       forms; Hessians on a box
    cancellation       dV/dt, exactly                  lasalle, level  where dV/dt = 0; sublevel sets
    interval           enclosures                      linearisation   eigenvalues, a V
    counterexample     what refutes                    chetaev         instability
    theorems, report   what follows from it
"""

from hil.proof.branch_and_bound import Budget
from hil.proof.report import Certificate, Decrease, Equilibrium, Report, Truth
from hil.proof.theorems import verify

__all__ = ["Budget", "Certificate", "Decrease", "Equilibrium", "Report", "Truth", "verify"]
