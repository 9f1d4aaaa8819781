"""A log replays to the bit, whatever kernels OpenBLAS and the C mathematics library choose.

Each variant must show that it chooses other kernels here: the same solve, or the same sines, with other bits.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hil.app.configuration.configuration import load
from hil.app.sim.command import simulate
from tests.loop.bench import changed

PROBE = """
import hashlib, json, math, struct
import numpy as np
g = np.random.default_rng(1)
blas, libm = hashlib.sha256(), hashlib.sha256()
for _ in range(300):
    blas.update(np.linalg.solve(g.standard_normal((6, 6)), g.standard_normal(6)).tobytes())
for x in g.uniform(-50.0, 50.0, 20000):
    libm.update(struct.pack("<3d", math.sin(x), math.cos(x), math.exp(x)))
print(json.dumps({"blas": blas.hexdigest(), "libm": libm.hexdigest()}))
"""
VARIANTS = {
    "OpenBLAS for Haswell": ("blas", {"OPENBLAS_CORETYPE": "Haswell"}),
    "OpenBLAS for Prescott": ("blas", {"OPENBLAS_CORETYPE": "Prescott"}),
    "libm without FMA": ("libm", {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA"}),
    "both for old processors": (
        "libm",
        {"OPENBLAS_CORETYPE": "Nehalem", "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX"},
    ),
}
REPLAY = """
import sys
from hil.cli import main
for log in sys.argv[1:]:
    try:
        main(["replay", log, "--json", log + ".json"])
    except SystemExit as end:
        assert end.code == 0
"""
# What each path needs of the controller: polynomials and inverse dynamics; sines and another robot; a centre of
# mass off every axis, where a dot product would round by kernel.
RECORDED = ("virtual", "lab", "aside")


def python(variables, *words):
    done = subprocess.run(
        [sys.executable, *words], env={**os.environ, **variables}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def probe(variables):
    return json.loads(python(variables, "-c", PROBE))


@pytest.fixture(scope="module")
def usual():
    return probe({})


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    centre = {"platform": {"com_m": [0.075, 0.238, 0.165]}}
    for name in RECORDED:
        c = changed("virtual", platform=centre) if name == "aside" else load(name)
        assert simulate(c, log=folder / f"{name}.mcap", duration_s=1.5)["success"]
    return folder


@pytest.mark.long
@pytest.mark.parametrize(("library", "variables"), VARIANTS.values(), ids=VARIANTS)
def test_replay_is_exact_with_other_kernels(usual, logs, tmp_path, library, variables):
    differs = probe(variables)[library] != usual[library]
    copies = [shutil.copy(logs / f"{name}.mcap", tmp_path) for name in RECORDED]
    python(variables, "-c", REPLAY, *copies)
    for copy in copies:
        summary = json.loads(Path(f"{copy}.json").read_text())
        assert summary["success"] is True
        assert summary["ticks"] > 1500
        assert summary["wire_different_ticks"] == 0
        assert summary["different_ticks"] == 0
    if not differs:
        pytest.skip(
            f"replay is exact, but {variables} changes no bit of {library} here, so this proves nothing"
        )
