"""Put classical mistakes into the sources of the model and print each one's worst relative error.

Runs as a script with Numba disabled: the mutated sources are plain Python then.
"""

import json
import sys
import types
from pathlib import Path

import numpy as np

import hil
from hil.geometry import Platform

HERE = Path(hil.__file__).parent
KERNELS, MODEL = "kernels/dynamics.py", "dynamics.py"

MUTATIONS = {
    "unchanged": (KERNELS, "", ""),
    "l - c2 replaced by c2 in the inertia": (KERNELS, "m2 * (l - c2) * (l - c2)", "m2 * c2 * c2"),
    "l - c2 replaced by c2 in its rate": (KERNELS, "(m2 * (l - c2) - inertia", "(m2 * c2 - inertia"),
    "l - c2 replaced by c2 in the weight": (KERNELS, "c[ROD_MASS] * (l - c[ROD_COM])) / l", "c[ROD_MASS] * c[ROD_COM]) / l"),
    "rod mass dropped": (MODEL, "c[kernels.ROD_MASS] = k * rod.mass", "pass"),
    "cylinder mass dropped": (MODEL, "c[kernels.CYLINDER_MASS] = k * cylinder.mass", "pass"),
    "cylinder and rod exchanged": (MODEL, "cylinder, rod = platform.cylinder, platform.rod", "rod, cylinder = platform.cylinder, platform.rod"),
    "inertia not rotated in M": (KERNELS, "column = rotate(R, inertia_times(c, column))", "column = at(c, INERTIA + 3 * j)"),
    "inertia not rotated in the moment": (KERNELS, "return force, add(rotate(R, turning)", "return force, add(turning"),
    "parallel axis doubled": (MODEL, "+ m * ((x @ x)", "+ 2 * m * ((x @ x)"),
    "parallel axis left out": (MODEL, "+ m * ((x @ x)", "+ 0 * m * ((x @ x)"),
    "centre of mass ignored": (MODEL, "c[kernels.COM : kernels.COM + 3] = x", "pass"),
    "H = 0": (KERNELS, "    elif code == FULL:", "    elif code == -1:"),
    "omega in the platform frame": (KERNELS, "    v, w = at(twist, 0), at(twist, 3)\n    dv", "    v, w = at(twist, 0), rotate_back(R, at(twist, 3))\n    dv"),
    "wrench with the wrong sign": (KERNELS, "f[i] -= wrench[i]", "f[i] += wrench[i]"),
    "spin inertia dropped": (MODEL, "        if spin:", "        if not spin:"),
    "spin's gyroscopic term dropped": (KERNELS, "force = add(force, scale(c[AXIAL] * spin / l, cross(ds, s)))", "pass"),
}  # fmt: skip


def load(name, file, text):
    """Return the module hil.NAME made from this text, in place of the one in the repository."""
    module = types.ModuleType(name)
    sys.modules[name] = module
    exec(compile(text, str(HERE / file), "exec"), module.__dict__)
    return module


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
            for value, key in (
                (m.inverse_dynamics(p, R, twist, dtwist, wrench), prefix + "leg_forces"),
                (m.mass_matrix(p, R), prefix + "M"),
            ):
                expected = np.array(e[key])
                worst = max(worst, float(np.abs(value - expected).max() / np.abs(expected).max()))
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
        hil.kernels.dynamics = load("hil.kernels.dynamics", KERNELS, texts[KERNELS])
        result[name] = worst_error(load("hil.dynamics", MODEL, texts[MODEL]), cases)
    print(json.dumps(result))


if __name__ == "__main__":
    import hil.kernels.dynamics

    main()
