"""A plant of one's own with PythonFMU: a rigid platform on six massless legs with brakes.

Build it with `pythonfmu build -f pythonfmu_plant.py`. Replace the physics by yours. What the bridge needs of
it are six forces in, six lengths and six rates out, in N, m and m/s, right from initialisation on. The
parameters have the names that `hil new --fmu` looks for.
"""

import numpy as np
from pythonfmu import Fmi2Causality, Fmi2Initial, Fmi2Slave, Fmi2Variability, Real

LEGS = range(1, 7)
PARAMETERS = {
    "mass": 1.0,  # kg
    "com_height": 0.0,  # m, above the plane of the platform joints
    "inertia_x": 0.01, "inertia_y": 0.01, "inertia_z": 0.01,  # kg m^2, about the centre of mass
    "base_radius": 0.2, "base_half_angle_deg": 10.0,  # pairs of joints about 0, 120, 240 deg
    "platform_radius": 0.15, "platform_half_angle_deg": 10.0,  # about 60, 180, 300 deg
    "home_height": 0.3,  # m, where it starts
    "gravity_z": -9.81,  # m/s^2; positive for a robot that hangs
}  # fmt: skip


def joints(radius, centres_deg, half_deg):
    """Return six joint centres (6, 3) m, the two of a pair at its centre minus and plus the half angle."""
    angles = np.deg2rad([c + side * half_deg for c in centres_deg for side in (-1, 1)])
    return radius * np.column_stack((np.cos(angles), np.sin(angles), np.zeros(6)))


def cross(a, b):
    """Return the cross product of rows of three; np.cross takes ten times as long for so few."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]


def turned(R, rotation):
    """Return R after a rotation vector (3,) rad in the base frame (Rodrigues)."""
    angle = float(np.linalg.norm(rotation))
    if angle == 0.0:
        return R
    x, y, z = rotation / angle
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return (np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K) @ R


class PythonPlant(Fmi2Slave):
    """Newton-Euler about the centre of mass, semi-implicit Euler; a closed brake locks its leg."""

    author = "you"
    description = "Rigid platform on six massless legs"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        for name, value in PARAMETERS.items():
            setattr(self, name, value)
            kind = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.tunable}
            self.register_variable(Real(name, **kind))
        for i in LEGS:
            for name in (f"force{i}", f"brake{i}"):
                setattr(self, name, 0.0)
                self.register_variable(Real(name, causality=Fmi2Causality.input))
            for name in (f"length{i}", f"rate{i}"):
                setattr(self, name, 0.0)
                kind = {"causality": Fmi2Causality.output, "initial": Fmi2Initial.calculated}
                self.register_variable(Real(name, **kind))

    def exit_initialization_mode(self):
        """Put the platform at rest at home; the parameters are known now."""
        self.a = joints(self.base_radius, (0, 120, 240), self.base_half_angle_deg)
        b = joints(self.platform_radius, (60, 180, 300), self.platform_half_angle_deg)
        self.b = np.roll(b, 1, axis=0) - [0, 0, self.com_height]  # leg 1 stands on the last pair's second
        self.I = np.diag([self.inertia_x, self.inertia_y, self.inertia_z])
        self.c = np.array([0, 0, self.home_height + self.com_height])
        self.R = np.eye(3)
        self.twist = np.zeros(6)
        self.show()

    def jacobian(self):
        """Return J (6, 6), dq = J [v of the centre of mass; omega], and the lengths (6,) m."""
        r = self.b @ self.R.T
        legs = self.c + r - self.a
        q = np.linalg.norm(legs, axis=1)
        s = legs / q[:, None]
        return np.hstack((s, cross(r, s))), q

    def show(self):
        """Fill the outputs."""
        J, q = self.jacobian()
        for i, length, rate in zip(LEGS, q, J @ self.twist, strict=True):
            setattr(self, f"length{i}", float(length))
            setattr(self, f"rate{i}", float(rate))

    def do_step(self, current_time, step_size):
        """Move on by step_size s in steps of at most 2.5 ms."""
        steps = int(np.ceil(step_size / 2.5e-3 - 1e-9))
        for _ in range(steps):
            self.advance(step_size / steps)
        self.show()
        return True

    def advance(self, dt):
        """Take one step of dt s."""
        J, _ = self.jacobian()
        tau = np.array([getattr(self, f"force{i}") for i in LEGS])
        shut = np.array([getattr(self, f"brake{i}") > 0.5 for i in LEGS])
        I, w = self.R @ self.I @ self.R.T, self.twist[3:]
        M = np.zeros((6, 6))
        M[:3, :3], M[3:, 3:] = self.mass * np.eye(3), I
        weight = np.array([0, 0, self.mass * self.gravity_z, 0, 0, 0])
        weight[3:] = -cross(w, I @ w)
        V = self.twist + dt * np.linalg.solve(M, J.T @ tau + weight)
        if shut.any():  # the impulses that leave the braked legs at rest
            B = J[shut]
            impulse = np.linalg.solve(B @ np.linalg.solve(M, B.T), B @ V)
            V = V - np.linalg.solve(M, B.T @ impulse)
        self.twist = V
        self.c = self.c + dt * V[:3]
        self.R = turned(self.R, dt * V[3:])
