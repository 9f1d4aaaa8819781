"""Consistency of the fused pose, for docs/theory/estimation.md: `python -m tests.loop.fusion_figures --json FILE`."""

from __future__ import annotations

import itertools
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from plant_fmu.faults.kinds import EncoderLost
from tests.loop.fusion_runs import ANY_LEG, Tracked, track
from tests.loop.test_fusion import covariance, stated, used

RUNS: dict[str, tuple[str, dict[str, Any] | None, dict[str, Any]]] = {
    "virtual": ("virtual", None, {}),
    "lab": ("lab", None, {}),
    "lab without f": ("lab", {"leg_force_std_N": 0}, {}),
}
LEGS = (1, 2, 4)
LOST: dict[str, tuple[range, dict[str, Any]]] = {
    "lost": (range(1, 5), {}),
    "lost, whole ride": (range(1, 3), {"reference": {}}),
}


def figures(found: Tracked) -> dict[str, float]:
    """Figures of a row of the table."""
    nees = found.nees()
    return {
        "mean": float(nees.mean()),
        "99 % below": float(np.quantile(nees, 0.99)),
        "pose": float(found.nees(last=6).mean()),
        "twist": float(found.nees(first=6).mean()),
        "left_out": float(np.mean(used(found) == 0)),
        "rms_um": 1e3 * found.rms_mm,
    }


def main() -> None:
    """Run all cases and write their figures."""
    result: dict[str, Any] = {}
    for name, (base, fusion, sections) in RUNS.items():
        result[name] = figures(track(stated(base, fusion, **sections), seed=1, covariance=covariance))
    for name, (seeds, sections) in LOST.items():
        means = []
        for leg, seed in itertools.product(LEGS, seeds):
            c = stated("lab", ANY_LEG, **sections)
            found = track(c, EncoderLost(leg=leg, at_s=3.0), seed=seed, covariance=covariance)
            means.append(float(found.nees()[used(found)[:, leg] == 0].mean()))
        result[name] = sorted(means)
    Path(sys.argv[sys.argv.index("--json") + 1]).write_text(json.dumps(result))


if __name__ == "__main__":
    main()
