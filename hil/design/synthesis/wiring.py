"""A block diagram, written down by the names of its signals, as one linear system."""

import numpy as np

from drivers.arrays import Array
from hil.mathematics.linear_system import LinearSystem, static

Sum = dict[str, float]
"""Signals and their factors; a signal is an external input, or the output of the part of that name."""


def wired(parts: dict[str, tuple[LinearSystem, Sum]], inputs: list[str], outputs: list[Sum]) -> LinearSystem:
    """Return the system from `inputs` to `outputs`; each part has one input, a sum, and one output, its name.

    Raises ModelError where parts without states feed one another in a ring without a solution.
    """
    names = list(parts)
    body = static(np.zeros((0, 0)))
    for system, _ in parts.values():
        body = body.beside(system)

    def rows(sums: list[Sum], signals: list[str]) -> Array:
        return np.array([[one.get(signal, 0.0) for signal in signals] for one in sums])

    known = set(names) | set(inputs)
    feeds = [feed for _, feed in parts.values()]
    assert all(set(one) <= known for one in [*feeds, *outputs]), "a signal without a source"
    # from [inputs; fed] to [outputs; parts' outputs], then parts' outputs back to what they feed
    m, n = len(inputs), len(names)
    into = static(np.hstack([np.zeros((n, m)), np.eye(n)]))
    through = body.after(into)
    direct = np.hstack([rows(outputs, inputs), np.zeros((len(outputs), n))])
    system = through._replace(
        C=np.vstack([rows(outputs, names) @ through.C, through.C]),
        D=np.vstack([direct + rows(outputs, names) @ through.D, through.D]),
    )
    # fed = F parts + E inputs: the part of the inputs goes in beforehand
    F, E = rows(feeds, names), rows(feeds, inputs)
    source = static(np.block([[np.eye(m), np.zeros((m, n))], [E, np.eye(n)]]))
    return system.after(source).closed_with(static(F))


def well_scaled(system: LinearSystem) -> LinearSystem:
    """Return the same system with states of such units that each is moved as strongly as it acts.

    Row and column of each state in [A B; C 0] get the same norm, by powers of 2, so that nothing is rounded
    (Osborne 1960). The tests of rank in a synthesis compare numbers of one size then.
    """
    A, B, C = system.A.copy(), system.B.copy(), system.C.copy()
    for _ in range(30):
        for i in range(system.order):
            others = np.arange(system.order) != i
            row = np.linalg.norm(np.concatenate([A[i, others], B[i]]))
            column = np.linalg.norm(np.concatenate([A[others, i], C[:, i]]))
            if row > 0.0 and column > 0.0:
                t = 2.0 ** np.round(0.5 * np.log2(row / column))
                A[i], B[i] = A[i] / t, B[i] / t
                A[:, i], C[:, i] = A[:, i] * t, C[:, i] * t
    return system._replace(A=A, B=B, C=C)
