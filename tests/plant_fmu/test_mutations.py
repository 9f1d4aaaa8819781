"""Typical mistakes in the plant's equations: comparison with physics engines must detect each."""

import shutil
import subprocess

import numpy as np
import pytest

from plant_fmu.stewart.build import FLAGS, find_compiler

from .conftest import Direct
from .test_rigid_body import load, relative

MUTATIONS = {
    "c2 in place of l - c2": ("const double out = l - c2, m2out", "const double out = c2, m2out"),
    "cylinder mass dropped": ("m1 = body->cylinder_mass, m2", "m1 = 0.0 * body->cylinder_mass, m2"),
    "rod mass dropped": ("m2 = body->rod_mass;", "m2 = 0.0 * body->rod_mass;"),
    "inertia not rotated": (
        "rotated_inertia(R, body->inertia, I);",
        "for (int k = 0; k < 9; k++) I[k] = body->inertia[k];",
    ),
    "parallel axis twice": ("const double rr = m * dot(rc, rc);", "const double rr = 2.0 * m * dot(rc, rc);"),
    "no centrifugal force of the platform": (
        "force = times(m, minus(vec(body->gravity), cross(w, cross(w, rc))));",
        "force = times(m, vec(body->gravity));",
    ),
    "no Coriolis force of the leg": ("along = 2.0 * dl *", "along = 0.0 * dl *"),
    "wrench with the wrong sign": ("e->rhs[2] = wrench[2] + force.z", "e->rhs[2] = force.z - wrench[2]"),
    "axial and transverse swapped": ("I0 = body->cylinder_inertia[1] +", "I0 = body->cylinder_inertia[0] +"),
    "spin without its reaction": ("minus(times(drift, y), times(spin, cross(s, ds)))", "times(drift, y)"),
}


def worst_error(plant, truth):
    worst = 0.0
    for case in truth["cases"][::3]:
        for leg_spin, prefix in (("none", ""), ("universal", "ujoint_")):
            load(plant, truth["geometries"][case["geometry"]], case["state"], leg_spin)
            plant.start(force=case["state"]["f"], wrench=case["state"]["wrench"], brake=np.zeros(6))
            want = case["expected"][prefix + "fd_a"] + case["expected"][prefix + "fd_alpha"]
            worst = max(worst, relative(plant.get("acceleration"), want, 1.0))
    return worst


@pytest.mark.parametrize("name", [None, *MUTATIONS])
def test_reference_engines_detect_every_mutation_of_the_plant_equations(unpacked, truth, tmp_path, name):
    folder, description = unpacked
    shutil.copytree(folder, tmp_path / "fmu")
    source = tmp_path / "fmu" / "sources" / "mechanics.c"
    if name is not None:
        old, new = MUTATIONS[name]
        text = source.read_text()
        assert text.count(old) >= 1
        source.write_text(text.replace(old, new))
    library = next((tmp_path / "fmu" / "binaries").glob("*/*"))
    library.unlink()
    units = sorted(p.name for p in source.parent.glob("*.c"))
    command = [*find_compiler().command, *FLAGS, "-O0", "-fPIC", "-o", str(library), *units, "-lm"]
    subprocess.run(command, cwd=source.parent, check=True)
    plant = Direct(tmp_path / "fmu", description)
    error = worst_error(plant, truth)
    plant.fmu.fmi3FreeInstance(plant.fmu.component)
    assert error <= 1e-9 if name is None else error > 1e-7, error
