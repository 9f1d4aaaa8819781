"""Put classical mistakes into the sources of the model and print a relative error that each one makes.

It is the worst of all cases, or of those up to the first in which the mistake is noticed.

Runs as a script with Numba disabled: the mutated sources are plain Python then.
"""

import json
import sys
import types
from pathlib import Path

import numpy as np

import hil
from hil.robot.geometry import Platform

SPREAD = np.array([1.0, 0.9, 0.8, 0.7, 0.6, 0.5])
HERE = Path(hil.__file__).parent
NOTICED = 1e-6
"""A mistake that makes an error above this needs no further case."""
KERNELS, MODEL = "robot/dynamics_kernels.py", "robot/dynamics.py"

MUTATIONS = {
    "unchanged": (KERNELS, "", ""),
    "l - c2 replaced by c2 in the inertia": (KERNELS, "m2 * (l - c2) * (l - c2)", "m2 * c2 * c2"),
    "l - c2 replaced by c2 in the potential energy": (KERNELS, "scale(l - c[ROD_COM], s)", "scale(c[ROD_COM], s)"),
    "l - c2 replaced by c2 in its rate": (KERNELS, "(m2 * (l - c2) - inertia", "(m2 * c2 - inertia"),
    "l - c2 replaced by c2 in the weight": (KERNELS, "c[ROD_MASS] * (l - c[ROD_COM])) / l", "c[ROD_MASS] * c[ROD_COM]) / l"),
    "rod mass dropped": (MODEL, "c[kernels.ROD_MASS] = k * rod.mass", "pass"),
    "cylinder mass dropped": (MODEL, "c[kernels.CYLINDER_MASS] = k * cylinder.mass", "pass"),
    "cylinder and rod exchanged": (MODEL, "cylinder, rod = platform.cylinder, platform.rod", "rod, cylinder = platform.cylinder, platform.rod"),
    "inertia not rotated in M": (KERNELS, "column = rotate(R, inertia_times(c, row(R, j)))", "column = at(c, INERTIA + 3 * j)"),
    "inertia not rotated in the moment": (KERNELS, "return force, add(rotate(R, turning)", "return force, add(turning"),
    "parallel axis doubled": (MODEL, "+ m * (square", "+ 2 * m * (square"),
    "parallel axis left out": (MODEL, "+ m * (square", "+ 0 * m * (square"),
    "parallel axis of the cylinder doubled": (KERNELS, "m1 * c1 * c1", "2 * m1 * c1 * c1"),
    "c1 from the wrong end": (KERNELS, "m1 * c1 * c1", "m1 * (l - c1) * (l - c1)"),
    "axial and transverse exchanged": (MODEL, "k * (cylinder.inertia_transverse + rod.inertia_transverse)", "k * (cylinder.inertia_axial + rod.inertia_axial)"),
    "centre of mass ignored": (MODEL, "c[kernels.COM : kernels.COM + 3] = x", "pass"),
    "H = 0": (KERNELS, "    elif code == FULL:", "    elif code == -1:"),
    "omega in the platform frame": (KERNELS, "    v, w = at(twist, 0), at(twist, 3)\n    dv", "    v, w = at(twist, 0), rotate_back(R, at(twist, 3))\n    dv"),
    "wrench with the wrong sign": (KERNELS, "f[i] -= wrench[i]", "f[i] += wrench[i]"),
    "spin inertia dropped": (MODEL, "        if spin:", "        if not spin:"),
    "spin's gyroscopic term dropped": (KERNELS, "force = add(force, scale(c[AXIAL] * spin / l, cross(ds, s)))", "pass"),
    "spin's second rate dropped": (KERNELS, "- 2.0 * dl / l * spin", ""),
    "reflected mass not in M": (KERNELS, "c[ROD_MASS] + c[REFLECTED + i] - across", "c[ROD_MASS] - across"),
    "reflected mass not in H": (KERNELS, "(m2 * c2 + c[REFLECTED + i] * l)", "(m2 * c2)"),
    "reflected mass of the first leg for all": (KERNELS, "c[ROD_MASS] + c[REFLECTED + i]", "c[ROD_MASS] + c[REFLECTED]"),
    "reflected mass with a weight": (KERNELS, "scale(-c[ROD_MASS] * along, s)", "scale(-(c[ROD_MASS] + c[REFLECTED]) * along, s)"),
    "viscous friction dropped": (MODEL, '_not_negative("viscous", "N s/m", viscous)', "0.0"),
    "Coulomb friction dropped": (MODEL, '_not_negative("coulomb", "N", coulomb)', "0.0"),
    "friction pushes in inverse dynamics": (KERNELS, "add_friction(c, p, R, twist, 1.0, tau)", "add_friction(c, p, R, twist, -1.0, tau)"),
    "friction pushes in forward dynamics": (KERNELS, "add_friction(c, p, R, twist, -1.0, drive)", "add_friction(c, p, R, twist, 1.0, drive)"),
    "friction of the origin's velocity alone": (KERNELS, "dq = dot(s, add(at(twist, 0), cross(at(twist, 3), r)))", "dq = dot(s, at(twist, 0))"),
    "Coulomb friction proportional to the rate": (KERNELS, "if dq > v_s:", "if dq > 1e9:"),
}  # fmt: skip


def load(name, file, text):
    """Return the module hil.NAME made from this text, in place of the one in the repository."""
    module = types.ModuleType(name)
    sys.modules[name] = module
    exec(compile(text, str(HERE / file), "exec"), module.__dict__)
    return module


DRIVES = {"reflected_mass": 500.0 * SPREAD, "viscous": 2000.0 * SPREAD, "coulomb": 150.0 * SPREAD[::-1]}


def worst_error(model, cases):
    platforms = {name: Platform.from_dict(d) for name, d in cases["geometries"].items()}
    worst = 0.0
    for case in cases["cases"]:
        s, e = case["state"], case["expected"]
        p, R = np.array(s["p"]), np.array(s["R"])
        twist, dtwist, wrench = (
            np.array(s["v"] + s["omega"]),
            np.array(s["a"] + s["alpha"]),
            np.array(s["wrench"]),
        )
        for prefix, spin in (("", "none"), ("ujoint_", "universal")):
            m = model.Model(platforms[case["geometry"]], leg_spin=spin)
            legs, weight = np.array(e[prefix + "leg_forces"]), max(np.abs(e["G"]).max(), 1.0)
            dq, ddq = np.array(e["rates"]), np.array(e["length_accels"])
            driven = model.Model(platforms[case["geometry"]], leg_spin=spin, sliding_speed=0.0, **DRIVES)
            tau = (
                legs
                + DRIVES["reflected_mass"] * ddq
                + DRIVES["viscous"] * dq
                + DRIVES["coulomb"] * np.sign(dq)
            )
            for value, want, floor in (
                (m.inverse_dynamics(p, R, twist, dtwist, wrench), legs, 0.0),
                (m.mass_matrix(p, R), e[prefix + "M"], 0.0),
                (
                    m.forward_dynamics(p, R, twist, s["f"], wrench),
                    e[prefix + "fd_a"] + e[prefix + "fd_alpha"],
                    1.0,
                ),
                (m.potential_energy(p, R), e["potential"], weight),
                (driven.inverse_dynamics(p, R, twist, dtwist, wrench), tau, 0.0),
                (driven.forward_dynamics(p, R, twist, tau, wrench), dtwist, 1.0),
            ):
                scale = max(float(np.abs(want).max()), floor)
                worst = max(worst, float(np.abs(np.asarray(value) - want).max()) / scale)
            if worst > NOTICED:
                return worst
    return worst


def main():
    cases = json.loads(Path(sys.argv[1]).read_text())
    sources = {name: (HERE / name).read_text() for name in (KERNELS, MODEL)}
    result = {}
    for name, (file, old, new) in MUTATIONS.items():
        texts = dict(sources)
        if old not in texts[file]:
            raise SystemExit(f"{name}: {old!r} is no longer in {file}")
        if old:
            texts[file] = texts[file].replace(old, new)
        hil.robot.dynamics_kernels = load("hil.robot.dynamics_kernels", KERNELS, texts[KERNELS])
        result[name] = worst_error(load("hil.robot.dynamics", MODEL, texts[MODEL]), cases)
    print(json.dumps(result))


if __name__ == "__main__":
    import hil.robot.dynamics_kernels

    main()
