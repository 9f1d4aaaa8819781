"""`hil` with a control law that raises an exception during motion."""

from __future__ import annotations

from drivers.tick_columns import Record
from hil.cli import main
from hil.control.inverse_dynamics import JointInverseDynamics
from hil.control.pointed_law import PointedLaw

_sound = JointInverseDynamics.effort


def _effort(self: PointedLaw, tick: Record) -> None:
    if abs(tick["dq"]).max() > 0.6:
        raise ZeroDivisionError("a law with a defect")
    _sound(self, tick)


if __name__ == "__main__":
    JointInverseDynamics.effort = _effort  # type: ignore[method-assign]
    main()
