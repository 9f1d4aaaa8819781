"""What moves the plant for its owner in Python, by the functions of the compiled pass."""

from typing import Any

from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import pointed
from plant_fmu.drives.live import NODES_RECORD, drive, move_to
from plant_fmu.drives.record import DONE


@pointed(NODES_RECORD, INTEGER)
def advance(n: Any, t_ns: int) -> int:
    """Bring the plant to the grid point nearest to an instant; return DONE or PLANT."""
    return move_to(n, t_ns)


@pointed(NODES_RECORD, INTEGER)
def actuate(n: Any, t_ns: int) -> int:
    """Set force and brake of the plant from the drives' states."""
    drive(n, t_ns, False)
    return DONE
