"""The rehearsal bench: drives, cables and legs of a wiring, and the actions of the operator.

Its answers are the plant's true state. Its only configuration is the figures from which it is built.
"""

from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array, Rows
from drivers.cia402 import objects as o
from drivers.config import DriveSettings
from drivers.errors import PlantError
from drivers.family import Family
from drivers.signals import LEGS
from plant_fmu.bench import UncoupledLegs
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.nodes import Nodes
from plant_fmu.drives.record import MUTE
from plant_fmu.faults.plan import FaultPlan
from plant_fmu.plant import Plant
from plant_fmu.rehearsal.wired_plant import WiredPlant
from plant_fmu.rehearsal.wiring import OWN, Wiring

TAPE_M = 2e-4
"""Standard deviation of a length that is measured by tape."""
GAUGE_SHARE = 3e-3
"""Standard deviation of a reading of the force gauge, as a share of the reading."""
LEVEL = 0.3
"""Cosine between gravity and the mean direction of the legs below which a weight neither presses nor pulls.
"""
HAND_SHARE = 0.05
"""Force of a hand, with a lever if necessary, as a share of the rated force."""
USUAL_FRICTION = 0.001
"""Friction of legs for which it is unknown, as a share of the rated force."""
GAUGE_YIELD_M = 5e-5
"""Deflection of a force gauge under its force."""
_DAMPING_N_s2_m2 = 2_000.0
_STEP_S = 1e-4


class TrestleLegs(UncoupledLegs):
    """Plant: six uncoupled legs, each on a stand of its own and at rest; x is the leg length, m.

    A hand on a leg is a force. A lever on the brake of a leg lets the operator move it anywhere. A force
    gauge holds the end of a leg with a spring.
    """

    def __init__(self, gauge_N: float, **figures: Any) -> None:
        """Create legs from fields of BENCH; gauge_N: force at which the gauge deflects by GAUGE_YIELD_M."""
        super().__init__(_STEP_S, damping=_DAMPING_N_s2_m2, **figures)
        self._gauge_N_m = gauge_N / GAUGE_YIELD_M

    def place(self, leg: int, length: float) -> None:
        """Move a leg to a length, m, limited by its ends of travel, with a lever on its brake."""
        at = self.legs
        at["x"][leg] = min(max(length, at["shortest"][leg]), at["longest"][leg])
        at["v"][leg] = 0.0

    def push(self, leg: int | list[int], force: float, *, on: bool = False) -> None:
        """Push a leg, or several, by hand, N, > 0 extends, 0: no hand; for HAND_M, or always (`on`)."""
        self.legs["hand"][leg], self.legs["hand_from"][leg] = force, np.inf if on else self.legs["x"][leg]

    def hold_at_gauge(self, leg: int | None) -> None:
        """Clamp the end of a leg to the force gauge; None releases it."""
        self.legs["stiffness"] = self.legs["origin"] = 0.0
        if leg is not None:
            self.legs["stiffness"][leg], self.legs["origin"][leg] = self._gauge_N_m, self.legs["x"][leg]

    def gauge(self) -> float:
        """Force gauge reading, N, > 0 if the leg pushes. Raises PlantError if no leg is clamped to it."""
        legs = self.legs
        if not legs["stiffness"].any():
            raise PlantError("rehearsal: no leg is clamped to the force gauge")
        return float(np.sum(legs["stiffness"] * (legs["x"] - legs["origin"])))


class WiredNodes(Nodes):
    """`Nodes` whose drives have the node numbers, watchdogs and losses of a `Wiring`.

    The protocol's state of drives is stored by node number: two drives with one number share it.
    """

    def __init__(self, wiring: Wiring, *given: Any) -> None:
        self._wiring = wiring
        super().__init__(*given)

    def start(self, t0_ns: int) -> None:
        """Start as `Nodes.start`, with the node numbers, watchdogs and missing drives of the wiring."""
        super().start(t0_ns)
        self._chance = np.random.default_rng(1)
        self.wire(self._wiring)

    @property
    def address(self) -> int:
        """Address as `Nodes.address`, but 0 if the wiring loses frames."""
        return 0 if self._wiring.frames_lost else super().address

    def advance(self, t_ns: int, received: Rows) -> Rows:
        """Advance as `Nodes.advance`; the wiring loses its share of the frames in both directions."""
        return self._kept(super().advance(t_ns, self._kept(received)))

    def _kept(self, frames: Rows) -> Rows:
        lost = self._wiring.frames_lost
        return frames[self._chance.random(len(frames)) >= lost] if lost else frames

    def wire(self, wiring: Wiring) -> None:
        """Set the node numbers, watchdogs and missing drives that a wiring states."""
        self._wiring = w = wiring
        n = self._record
        strange, absent = np.array(w.other_protocol), ~np.array(w.present)
        n["number"], n["waits"] = np.where(strange | absent, MUTE, w.answers_as), w.watchdog
        n["strange"] = np.where(strange, o.HEARTBEAT_ID + np.array(self._settings.node_ids), 0)
        n["wired"] = (n["number"] != OWN).any()


class Stand(NamedTuple):
    """Masses, forces, strokes and joints of a machine whose legs lie on stands."""

    mass_kg: float
    """Moving mass of a leg."""
    friction_N: float
    brake_N: float
    length_min: float
    """Shortest leg length in the configuration, m."""
    length_max: float
    base_joints: Array
    """Joint centres (6, 3) m in the frame of their body."""
    platform_joints: Array
    """Joint centres (6, 3) m in the frame of their body."""
    platform_kg: float
    """Mass of the platform."""
    presses: float
    """> 0 if the platform's weight compresses the legs, < 0 if it pulls them."""


class RehearsalBench:
    """Six emulated drives with legs on stands, on which a bring-up can be rehearsed.

    Mutable state: the nodes, the legs, the random errors of readings, whether the platform is mounted, and
    the wiring, which changes when it is mounted.
    """

    def __init__(
        self,
        protocol: Family,
        emulation: DriveEmulation,
        settings: DriveSettings,
        stand: Stand,
        wiring: Wiring,
        seed: int = 1,
        faults: FaultPlan | None = None,
    ) -> None:
        self.stand, self.wiring = stand, wiring
        self.hung = False
        """True while the legs carry the platform."""
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
        self.protocol = protocol
        self.cables = self.behind_cables(self._legs, wiring)
        self.nodes = WiredNodes(wiring, self.cables, protocol, emulation, settings, faults)
        self._chance = np.random.default_rng(seed)

    def behind_cables(self, plant: Plant, wiring: Wiring) -> WiredPlant:
        """Plant with the mistakes of a wiring; encoder scales have no error at the middle of the stroke."""
        middle = 0.5 * (self.stand.length_min + self.stand.length_max)
        return WiredPlant(plant, wiring, np.full(LEGS, middle), self._rated_N)

    def length(self, leg: int) -> float:
        """True length of a leg, m."""
        return float(self._legs.legs["x"][leg])

    def _read(self, value: float) -> float:
        """Force gauge or scales reading for a true value, with a random error."""
        return value * (1.0 + GAUGE_SHARE * float(self._chance.standard_normal()))

    def do(self, act: str, leg: int = -1, value: float = 0.0) -> float:
        """Execute an action of the operator; returns the operator's reading, 0 for an action without one.

        leg: for acts on one leg. value: for `move`, m by which a lever on the brake moves the leg; for
        `place`, the target as a share of the configured stroke, limited by the ends of travel. Hands push
        with HAND_SHARE of the rated force. They read the force at which a free leg moves, or the force of
        the push while the leg holds. `clamp` fixes a leg to the force gauge, `free` releases it. `weigh`
        weighs the platform. `read_way` is 1 if the platform's weight compresses the legs, -1 if it pulls
        them, 0 for neither.
        """
        legs, s, push = self._legs, self.stand, HAND_SHARE * self._rated_N
        match act:
            case "move":
                legs.place(leg, self.length(leg) + value)
            case "place":
                legs.place(leg, s.length_min + value * (s.length_max - s.length_min))
            case "measure":
                return self.length(leg) + TAPE_M * float(self._chance.standard_normal())
            case "push" | "push_on":
                legs.push(leg, push, on=act == "push_on")
            case "push_others":
                legs.push([other for other in OWN if other != leg], push)
            case "read_push":
                return self._read(min(float(legs.legs["friction"][leg]), push))
            case "read_held":
                return self._read(float(legs.legs["hand"][leg]))
            case "let_go":
                legs.push(leg, 0.0)
            case "let_go_all":
                legs.push([*OWN], 0.0)
            case "clamp":
                legs.hold_at_gauge(leg)
            case "free":
                legs.hold_at_gauge(None)
            case "read_gauge":
                return self._read(legs.gauge())
            case "weigh":
                return self._read(self.wiring.payload * s.platform_kg)
            case "read_way":
                way = self.wiring.gravity * s.presses
                return float(np.sign(way)) if abs(way) > LEVEL else 0.0
            case "take_down" | "carry":
                self.hung = False
        return 0.0

    def hang(self, p: Array, R: Array) -> None:
        """Mount the platform at p (3,) m, R (3, 3), base frame, plus the wiring's home error; moves the legs.

        Mistakes that are made when mounting take effect here.
        """
        self.hung, wiring = True, self.wiring.as_mounted
        if wiring is not self.wiring:
            self.wiring = wiring
            self.cables.wire(wiring)
            self.nodes.wire(wiring)
        base, platform = joints_of(self.wiring, self.stand.base_joints, self.stand.platform_joints)
        there = p + np.array([0.0, 0.0, self.wiring.home_off_m])
        for leg, length in enumerate(np.linalg.norm(there + platform @ R.T - base, axis=1)):
            self._legs.place(leg, float(length))


def joints_of(wiring: Wiring, base: Array, platform: Array) -> tuple[Array, Array]:
    """Base and platform joints (6, 3) m to which the legs are mounted, from the correct joints."""
    radius = np.hypot(base[:, 0], base[:, 1])[:, None]
    outwards = base / np.where(radius > 0.0, radius, np.inf) * (1.0, 1.0, 0.0)
    moved = base + np.array(wiring.joint_off_m)[:, None] * outwards
    return moved[list(wiring.base_joint)], platform[list(wiring.platform_joint)]
