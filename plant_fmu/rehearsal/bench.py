"""The rehearsal bench: drives, cables and legs of a wiring, and the hands of who stands beside them.

What it answers is the plant's truth. It knows no configuration but the figures that it is built from.
"""

from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.config import DriveSettings
from drivers.protocol import DriveProtocol
from drivers.signals import LEGS
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.nodes import Nodes
from plant_fmu.faults.plan import FaultPlan
from plant_fmu.plant import Plant
from plant_fmu.rehearsal.legs import TrestleLegs
from plant_fmu.rehearsal.wired_drives import wired_drives
from plant_fmu.rehearsal.wired_plant import WiredPlant
from plant_fmu.rehearsal.wiring import Wiring

TAPE_M = 2e-4
"""Standard deviation of a length that is measured by tape."""
GAUGE_SHARE = 3e-3
"""Standard deviation of a reading of the force gauge, as a share of it."""
LEVEL = 0.3
"""Cosine between gravity and the legs' common way below which a weight neither presses nor pulls."""
HAND_SHARE = 0.05
"""A hand, with a lever where it has to, pushes with this share of the rated force."""
USUAL_FRICTION = 0.001
"""Of legs whose friction is not known, as a share of the rated force."""


class Stand(NamedTuple):
    """Figures of a machine on trestles."""

    mass_kg: float
    """What moves in a leg."""
    friction_N: float
    brake_N: float
    length_min: float
    """m, ends of travel as the configuration has them."""
    length_max: float
    base_joints: Array
    """(6, 3) m."""
    platform_joints: Array
    """(6, 3) m."""
    platform_kg: float
    """What the platform weighs."""
    presses: float
    """> 0: its weight presses the legs together."""


class RehearsalBench:
    """Six drives before legs on trestles. Mutable state: the nodes, the legs, the chance of readings.

    And whether the platform hangs on the legs.
    """

    def __init__(
        self,
        protocol: DriveProtocol,
        emulation: DriveEmulation,
        settings: DriveSettings,
        stand: Stand,
        wiring: Wiring,
        seed: int = 1,
        faults: FaultPlan | None = None,
    ) -> None:
        self.stand, self.wiring = stand, wiring
        self.hung = False
        """The platform hangs on the legs."""
        self._rated_N = settings.force_limit_N
        stroke = stand.length_max - stand.length_min
        friction = max(stand.friction_N, USUAL_FRICTION * self._rated_N) + self._rated_N * np.array(
            wiring.friction
        )
        self._legs = TrestleLegs(
            0.02 * self._rated_N,
            mass=stand.mass_kg,
            friction=friction,
            brake=stand.brake_N,
            shortest=stand.length_min - 0.02 * stroke,
            longest=stand.length_max + stroke * (0.02 - np.array(wiring.shorter)),
            x=stand.length_min + np.linspace(0.35, 0.6, LEGS) * stroke,
        )
        self.drives_end = wired_drives(protocol, wiring, settings.node_ids)
        self.cables = self.behind_cables(self._legs)
        self.nodes = Nodes(self.cables, self.drives_end, emulation, settings, faults)
        self._chance = np.random.default_rng(seed)

    def behind_cables(self, plant: Plant) -> WiredPlant:
        """Return a plant as this wiring connects it; encoders are right at the middle of the stroke."""
        middle = 0.5 * (self.stand.length_min + self.stand.length_max)
        return WiredPlant(plant, self.wiring, np.full(LEGS, middle), self._rated_N)

    def length(self, leg: int) -> float:
        """Return the true length of a leg, m."""
        return float(self._legs.legs["x"][leg])

    # hands

    def measure(self, leg: int) -> float:
        """Measure a leg by tape, m."""
        return self.length(leg) + TAPE_M * float(self._chance.standard_normal())

    def move(self, leg: int, by_m: float) -> None:
        """Move a leg with a lever on its brake."""
        self._legs.place(leg, self.length(leg) + by_m)

    def place(self, leg: int, share: float) -> None:
        """Move a leg to a share of its stroke as configured, 0 shortest, 1 longest, as far as it goes."""
        s = self.stand
        self._legs.place(leg, s.length_min + share * (s.length_max - s.length_min))

    def push(self, leg: int) -> None:
        """Push a leg by hand."""
        self._legs.push(leg, HAND_SHARE * self._rated_N)

    def push_others(self, leg: int) -> None:
        """Push all legs but one by hand."""
        for other in range(LEGS):
            if other != leg:
                self.push(other)

    def _read(self, value: float) -> float:
        """Read the force gauge or the scales, at which this is."""
        return value * (1.0 + GAUGE_SHARE * float(self._chance.standard_normal()))

    def read_push(self, leg: int) -> float:
        """Read the hand's force gauge, N: what a free leg gave way at."""
        return self._read(min(float(self._legs.legs["friction"][leg]), HAND_SHARE * self._rated_N))

    def read_held(self, leg: int) -> float:
        """Read the hand's force gauge while a leg holds, N."""
        return self._read(float(self._legs.legs["hand"][leg]))

    def let_go(self, leg: int) -> None:
        """Take the hand away."""
        self._legs.push(leg, 0.0)

    def let_go_all(self) -> None:
        """Take all hands away."""
        for leg in range(LEGS):
            self.let_go(leg)

    def clamp(self, leg: int | None) -> None:
        """Clamp a leg to the force gauge; None frees it."""
        self._legs.hold_at_gauge(leg)

    def read_gauge(self) -> float:
        """Read the force gauge, N."""
        return self._read(self._legs.gauge())

    def weigh(self) -> float:
        """Weigh the platform, kg."""
        return self._read(self.wiring.payload * self.stand.platform_kg)

    def way(self) -> float:
        """Return 1 where the platform's weight presses the legs together, -1 where it pulls, 0: neither."""
        way = self.wiring.gravity * self.stand.presses
        return float(np.sign(way)) if abs(way) > LEVEL else 0.0

    def hang(self, p: Array, R: Array) -> None:
        """Hang the platform, its legs mounted as they are, at p (3,) m, R (3, 3), or where that is."""
        self.hung = True
        base, platform = joints_of(self.wiring, self.stand.base_joints, self.stand.platform_joints)
        there = p + np.array([0.0, 0.0, self.wiring.home_off_m])
        for leg, length in enumerate(np.linalg.norm(there + platform @ R.T - base, axis=1)):
            self._legs.place(leg, float(length))

    def take_down(self) -> None:
        """Take the platform off the legs, which lie on trestles again."""
        self.hung = False


def joints_of(wiring: Wiring, base: Array, platform: Array) -> tuple[Array, Array]:
    """Return base and platform joints (6, 3) m of the legs as they are mounted, of those they should have."""
    radius = np.hypot(base[:, 0], base[:, 1])[:, None]
    outwards = base / np.where(radius > 0.0, radius, np.inf) * (1.0, 1.0, 0.0)
    moved = base + np.array(wiring.joint_off_m)[:, None] * outwards
    return moved[list(wiring.base_joint)], platform[list(wiring.platform_joint)]
