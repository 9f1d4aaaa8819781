"""Rule on tracking: the leg error against a limit that grows with the commanded speed."""

from drivers.arrays import Array
from drivers.compiled.compiler import helper


@helper
def lagging(q: Array, q_d: Array, dq_d: Array, at_rest: float, per_speed: float) -> bool:
    """Tell whether |q_d - q| > at_rest + per_speed |dq_d| on some leg.

    q, q_d (6,) m measured and reference lengths, dq_d (6,) m/s reference rates; at_rest m, per_speed s.
    """
    for i in range(6):  # noqa: SIM110 - compiled
        if abs(q_d[i] - q[i]) > at_rest + per_speed * abs(dq_d[i]):
            return True
    return False
