"""The forces of a what-if as a picture: each leg's, recorded and answered, and the difference."""

from pathlib import Path

import numpy as np

from drivers.arrays import Array, Rows
from drivers.signals import LEGS
from hil.study.plot.draw import Curve, draw


class Forces:
    """Forces of all ticks. Mutable state: the blocks kept so far."""

    def __init__(self) -> None:
        self._t_ns: list[Array] = []
        self._recorded: list[Array] = []
        self._answered: list[Array] = []

    def keep(self, recorded: Rows, answered: Rows) -> None:
        """Keep the forces of a block."""
        self._t_ns.append(recorded["t_ns"].copy())
        self._recorded.append(recorded["tau"].copy())
        self._answered.append(answered["tau"].copy())

    def draw(self, path: Path, title: str) -> None:
        """Draw a panel a leg and one of the differences. Raises LogError: the file cannot be written."""
        t_ns = np.concatenate(self._t_ns)
        t = (t_ns - t_ns[0]) * 1e-9
        there, here = (np.concatenate(each) for each in (self._recorded, self._answered))
        legs = range(LEGS)
        panels = [
            [_curve("recorded", 0, t, there[:, leg]), _curve("what-if", 1, t, here[:, leg])] for leg in legs
        ]
        panels.append([_curve(f"leg_{leg}", 0, t, here[:, leg] - there[:, leg]) for leg in legs])
        titles = [*(f"tau.leg_{leg}" for leg in legs), "tau: what-if - recorded"]
        draw(titles, panels, path, title, option="--plot")


def _curve(label: str, style: int, t: Array, values: Array) -> Curve:
    return Curve(label, style, t, values, "N", {}, flags=False)
