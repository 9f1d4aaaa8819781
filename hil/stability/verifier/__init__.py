"""The verifier: given f and V, what V proves, and what is known of the equilibrium.

Proofs are exact algebra and interval arithmetic; nothing is proven by samples, by floating point or by a
solver's tolerance. In doubt a claim is undecided.

::

    system          the question in exact form        signs            definite, semidefinite, positive
    cancellation    dV/dt, exactly                    origin, tail     near the equilibrium and far away
    interval        enclosures                        lasalle, level   where dV/dt = 0; sublevel sets
    branch_and_bound                                  linearisation, chetaev   eigenvalues; instability
    counterexample  what refutes                      theorems, report
    picture         V, level sets and trajectories of two states
"""

from hil.stability.verifier.branch_and_bound import Budget
from hil.stability.verifier.report import Certificate, Decrease, Equilibrium, Report, Truth
from hil.stability.verifier.theorems import verify

__all__ = ["Budget", "Certificate", "Decrease", "Equilibrium", "Report", "Truth", "verify"]
