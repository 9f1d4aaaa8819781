"""Six emulated drives that are set up wrongly: node numbers, watchdogs, presence."""

from typing import Any

import numpy as np

from drivers.cia402 import objects as o
from plant_fmu.drives.nodes import Nodes
from plant_fmu.drives.record import MUTE
from plant_fmu.rehearsal.wiring import OWN, Wiring


class WiredNodes(Nodes):
    """`Nodes` whose drives are set up as a wiring has them.

    What drives remember is by the number that they answer to: two with one number share it.
    """

    def __init__(self, wiring: Wiring, *given: Any) -> None:
        """Take the wiring, and what `Nodes` takes."""
        self._wiring = wiring
        super().__init__(*given)

    def start(self, t0_ns: int) -> None:
        """As `Nodes.start`."""
        super().start(t0_ns)
        n, w = self._record, self._wiring
        strange, absent = np.array(w.other_protocol), ~np.array(w.present)
        n["number"], n["waits"] = np.where(strange | absent, MUTE, w.answers_as), w.watchdog
        n["strange"] = np.where(strange, o.HEARTBEAT_ID + np.array(self._settings.node_ids), 0)
        n["wired"] = (n["number"] != OWN).any()
