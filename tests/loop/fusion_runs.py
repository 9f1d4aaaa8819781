"""Runs of a bench with a tracker of 1 mm and 0.1 deg: 200 Hz, 5 ms late, 5 % lost."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.arrays import Array
from drivers.signals import Fault, Mode, Warn
from hil.app.configuration.configuration import Configuration
from hil.app.sim.lockstep import Lockstep
from hil.loop.run_end import Ending
from plant_fmu.faults.fault import Fault as PlantFault
from tests.loop.bench import changed, run

TRACKER: dict[str, Any] = {"rate_Hz": 200, "position_std_m": 1e-3, "orientation_std_deg": 0.1}
ANY_LEG: dict[str, Any] = {"may_lose_legs": [0, 1, 2, 3, 4, 5]}
SOON: dict[str, Any] = {
    "engage": {"force_ramp_s": 0.05, "brake_release_s": 0.02, "blend_s": 0.1},
    "plant": {"drives": {"brake_open_ms": 20, "brake_close_ms": 20}},
    "reference": {"periods": 1},
}
"""One period of the book's path, which begins at home, with short waiting times before it."""
UNPROVEN = Mode.HELD, Fault.STALE
"""End of a run without one encoder: the path is completed, and then no estimate proves that leg's brake."""
LATCHED_NS = 75_000
"""Duration of SYNC on the bus; the drives latch at its end."""


def seen(base: str | Configuration, **sections: Any) -> Configuration:
    """A bench with a tracker and the fused pose, unless `sections` change them."""
    noise = {"position_noise_m": 1e-3, "orientation_noise_deg": 0.1, "latency_ms": 5, "lost_percent": 5}
    c = {"sensors": {"tracker": TRACKER}, "estimation": {"pose": "fused"}} | sections
    return changed(changed(base, plant={"sensors": {"tracker": noise}}), **c)


def fused(**sections: Any) -> Configuration:
    """`virtual` on one short period of the book's path with the fused pose; any encoder may be lost."""
    return seen(changed("virtual", **SOON), **{"estimation": {"pose": "fused", "fusion": ANY_LEG}} | sections)


class Tracked(NamedTuple):
    """One run, while TRACKING."""

    ending: Ending
    faults: Fault
    rows: Any
    e: Array
    """(n, 12) truth minus estimate: m, rad, m/s, rad/s, base frame."""
    P: Array
    """(n, 12, 12) the filter's covariance of e, if requested."""
    warned: Warn
    """All warnings since the brakes opened."""

    @property
    def end(self) -> tuple[Mode, Fault]:
        """Mode and faults at the end."""
        return self.ending.mode, self.faults

    @property
    def position_mm(self) -> Array:
        """Distance (n,) of the estimate from the truth, mm."""
        return np.asarray(1e3 * np.linalg.norm(self.e[:, :3], axis=1))

    @property
    def rms_mm(self) -> float:
        """Root mean square of that distance, mm."""
        return float(np.sqrt(np.mean(self.position_mm**2)))

    def nees(self, first: int = 0, last: int = 12) -> Array:
        """e^T P^-1 e of components first .. last, divided by their number, (n,)."""
        e, P = self.e[:, first:last], self.P[:, first:last, first:last]
        return np.asarray(
            np.einsum("ni,ni->n", e, np.linalg.solve(P, e[:, :, None])[:, :, 0]) / (last - first)
        )


def track(
    c: Configuration,
    *faults: PlantFault,
    seed: int = 1,
    covariance: Callable[[Lockstep], Array] = lambda _: np.zeros((0, 0)),
) -> Tracked:
    """Run a configuration to its end with a seed for the noise."""
    rows: list[Any] = []
    truths: list[tuple[int, Any]] = []
    covariances: list[Array] = []
    warned = 0

    def watch(lockstep: Lockstep, inp: Any, row: Any) -> None:
        nonlocal warned
        if lockstep.cycle.mode >= Mode.RELEASING:
            warned |= int(row["warnings"])
        if lockstep.cycle.mode is Mode.TRACKING:
            rows.append(row)
            truths.append((inp.t_ns + LATCHED_NS, lockstep.nodes.snapshot()))
            covariances.append(covariance(lockstep))

    c = changed(c, plant={"sensors": {"seed": seed}})
    ran = run(c, *faults, seed=seed, watch=watch)
    tracked = np.array(rows, rows[0].dtype)
    e, P = errors(tracked, truths), np.array(covariances)
    return Tracked(ran.ending, ran.cycle.faults, tracked, e, P, Warn(warned))


def errors(rows: Any, truths: list[tuple[int, Any]]) -> Array:
    """Truths, extrapolated to the given instants, minus rows; the plant's next grid point is 25 us later."""
    at = np.array([snapshot.t_ns for _, snapshot in truths]) * 1e-9
    dt = np.array([[(t_ns - snapshot.t_ns) * 1e-9] for t_ns, snapshot in truths])
    p, R, twist = (
        np.array([getattr(snapshot.truth, name) for _, snapshot in truths]) for name in ("p", "R", "twist")
    )
    dtwist = np.diff(twist, axis=0, prepend=twist[:1]) / np.diff(at, prepend=at[0] - 1e-3)[:, None]
    there = Rotation.from_rotvec(twist[:, 3:] * dt) * Rotation.from_matrix(R)
    turned = there * Rotation.from_matrix(rows["R"].reshape(-1, 3, 3)).inv()
    return np.hstack(
        (p + twist[:, :3] * dt - rows["p"], turned.as_rotvec(), twist + dtwist * dt - rows["twist"])
    )
