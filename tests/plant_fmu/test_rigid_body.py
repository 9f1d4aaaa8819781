"""The plant's equations, through the built FMU, against MuJoCo (confirmed by Pinocchio)."""

import numpy as np
import pytest

SPINS = [("none", ""), ("universal", "ujoint_")]


def relative(got, want, floor):
    want = np.ravel(np.asarray(want, float))
    return np.abs(np.ravel(got) - want).max() / max(np.abs(want).max(), floor)


def load(plant, g, state, leg_spin):
    plant.fmu.reset()
    plant.platform(g, leg_spin)
    plant.set(
        initial_position=state["p"], initial_rotation=state["R"], initial_twist=[*state["v"], *state["omega"]]
    )


@pytest.mark.parametrize(("leg_spin", "prefix"), SPINS)
def test_accelerations_in_30_states_agree_with_mujoco_within_1e_9(direct, truth, leg_spin, prefix):
    plant = direct()
    worst: dict[str, float] = {}
    for case in truth["cases"]:
        state, want = case["state"], case["expected"]
        load(plant, truth["geometries"][case["geometry"]], state, leg_spin)
        plant.start(force=state["f"], wrench=state["wrench"], brake=np.zeros(6))
        g_scale = np.abs(want["G"]).max()
        errors = {
            "a": relative(plant.get("acceleration")[:3], want[prefix + "fd_a"], 1.0),
            "alpha": relative(plant.get("acceleration")[3:], want[prefix + "fd_alpha"], 1.0),
            "length": relative(plant.get("length"), want["lengths"], 1.0),
            "rate": relative(plant.get("rate"), want["rates"], 1.0),
            "kinetic": relative(plant.get("kinetic_energy"), want[prefix + "kinetic"], 1.0),
            "potential": relative(plant.get("potential_energy"), want["potential"], g_scale),
        }
        worst = {k: max(e, worst.get(k, 0.0)) for k, e in errors.items()}
    assert max(worst.values()) <= 1e-9, worst


def test_reference_data_differ_between_free_and_universal_leg_spin(truth):
    differences = [
        relative(c["expected"]["ujoint_fd_alpha"], c["expected"]["fd_alpha"], 1.0) for c in truth["cases"]
    ]
    assert max(differences) > 1e-4


def quaternion_product(a, b):
    w, v = a[0] * b[0] - a[1:] @ b[1:], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
    return np.array([w, *v])


def matrix(q):
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


class Trajectory:
    """A reference simulation: its force law, with the FMU's acceleration at any state."""

    def __init__(self, plant, truth, sim, leg_spin):
        self.plant, self.sim, self.law = plant, sim, {k: np.array(v) for k, v in sim["force"].items()}
        load(plant, truth["geometries"][sim["geometry"]], sim["x0"], leg_spin)
        plant.set(brake=np.zeros(6))
        self.saved = plant.fmu.getFMUState()
        x0 = sim["x0"]
        R0 = np.array(x0["R"])
        w = np.sqrt(1 + np.trace(R0)) / 2
        q0 = np.array(
            [w, *(np.array([R0[2, 1] - R0[1, 2], R0[0, 2] - R0[2, 0], R0[1, 0] - R0[0, 1]]) / (4 * w))]
        )
        self.x0 = np.array([*x0["p"], *q0, *x0["v"], *x0["omega"]])

    def force(self, t, length, rate):
        f = self.law
        swing = f["amp"] * np.sin(2 * np.pi * f["hz"] * t + f["phase"])
        return f["f0"] + f["k"] * (f["L0"] - length) - f["d"] * rate + swing

    def derivative(self, t, x):
        plant = self.plant
        plant.fmu.setFMUState(self.saved)
        plant.set(initial_position=x[:3], initial_rotation=matrix(x[3:7]), initial_twist=x[7:])
        plant.fmu.enterInitializationMode()
        plant.set(force=self.force(t, plant.get("length"), plant.get("rate")))
        dq = 0.5 * quaternion_product(np.array([0.0, *x[10:]]), x[3:7])
        return np.concatenate([x[7:10], dq, plant.get("acceleration")])

    def integrate(self, h):
        x, out = self.x0, [self.x0]
        every = round((self.sim["t"][1] - self.sim["t"][0]) / h)
        for k in range(every * (len(self.sim["t"]) - 1)):
            t = k * h
            k1 = self.derivative(t, x)
            k2 = self.derivative(t + h / 2, x + h / 2 * k1)
            k3 = self.derivative(t + h / 2, x + h / 2 * k2)
            k4 = self.derivative(t + h, x + h * k3)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            if (k + 1) % every == 0:
                out.append(x)
        return np.array(out)


@pytest.mark.parametrize("index", [0, 1])
@pytest.mark.parametrize(("leg_spin", "prefix"), SPINS)
def test_trajectories_agree_with_an_independent_runge_kutta_within_1e_7_m(
    direct, truth, index, leg_spin, prefix
):
    sim = truth["simulations"][index]
    x = Trajectory(direct(), truth, sim, leg_spin).integrate(1e-3)
    assert np.abs(x[:, :3] - np.array(sim["expected"][prefix + "p"])).max() <= 1e-7
    if not prefix:
        R = np.array([matrix(q) for q in x[:, 3:7]])
        assert np.abs(R - np.array(sim["expected"]["R"])).max() <= 1e-6


def test_plant_motion_under_a_force_law_sampled_every_step_converges_at_first_order(direct, truth):
    sim = truth["simulations"][0]
    want = np.array(sim["expected"]["p"])
    errors = []
    for dt in (2e-3, 1e-3, 5e-4):
        plant = direct()
        path = Trajectory(plant, truth, sim, "none")
        plant.start()
        p = [plant.get("position")]
        every = round(0.05 / dt)
        for k in range(every * (len(want) - 1)):
            plant.set(force=path.force(k * dt, plant.get("length"), plant.get("rate")))
            plant.fmu.doStep(k * dt, dt)
            if (k + 1) % every == 0:
                p.append(plant.get("position"))
        errors.append(np.abs(np.array(p) - want).max())
    assert errors[1] < 5e-4
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.25)
    assert errors[1] / errors[2] == pytest.approx(2.0, abs=0.25)
