"""The same mechanism for MuJoCo: a free platform and six legs on universal joints, cut where they meet.

Imported only where MuJoCo is installed. Pose coordinates of MuJoCo: the platform's free joint, and for each
leg azimuth alpha, latitude beta and extension x of s = Q (sin beta, -sin alpha cos beta, cos alpha cos beta),
Q turning z to the leg's first direction.
"""

from importlib import import_module

import numpy as np

from drivers.arrays import Array
from hil.robot.geometry import Platform
from hil.robot.kinematics_kernels import jacobian_kernel, leg_lengths_kernel

mujoco = import_module("mujoco")
THIN = 1e-9
"""kg m^2, inertia of a leg half about its axis: MuJoCo takes no zero."""


class MujocoRobot:
    """Inverse dynamics by `mj_inverse` of the cut mechanism; closing it is our J^-T.

    Mutable state: MuJoCo's data, and the legs' directions and lengths as of `place`.
    """

    def __init__(self, platform: Platform, p0: Array, R0: Array) -> None:
        """Build the model with its legs in line with those of the pose p0 (3,) m, R0 (3, 3)."""
        self._a, self._b = platform.base_joints, platform.platform_joints
        self._l0 = leg_lengths_kernel(self._a, self._b, p0, R0)
        tips = p0 + self._b @ R0.T
        self._frames = [_frame((tip - a) / l) for tip, a, l in zip(tips, self._a, self._l0, strict=True)]
        self.model = mujoco.MjModel.from_xml_string(_xml(platform, self._l0, self._frames))
        self.data = mujoco.MjData(self.model)

    def place(self, p: Array, R: Array, twist: Array, dtwist: Array) -> None:
        """Set pose, twist and acceleration, as in `hil.robot.dynamics.Model`."""
        d, w, dw = self.data, twist[3:], dtwist[3:]
        d.qpos[:3] = p
        mujoco.mju_mat2Quat(d.qpos[3:7], R.ravel())
        d.qvel[:6] = *twist[:3], *(R.T @ w)
        d.qacc[:6] = *dtwist[:3], *(R.T @ dw)
        self._R, self._p = R, p
        self._tips = []
        for i, Q in enumerate(self._frames):
            r = R @ self._b[i]
            x = Q.T @ (p + r - self._a[i])
            u = Q.T @ (twist[:3] + np.cross(w, r))
            du = Q.T @ (dtwist[:3] + np.cross(dw, r) + np.cross(w, np.cross(w, r)))
            l = float(np.sqrt(x @ x))
            alpha, beta = float(np.arctan2(-x[1], x[2])), float(np.arcsin(x[0] / l))
            sa, ca, sb, cb = np.sin(alpha), np.cos(alpha), np.sin(beta), np.cos(beta)
            e = np.array([[0.0, -ca, -sa], [cb, sa * sb, -ca * sb], [sb, -sa * cb, ca * cb]])
            da, db, dl = (e @ u) / np.array([l * cb, l, 1.0])
            across, up, along = e @ du
            dda = ((across + 2.0 * l * db * da * sb) / cb - 2.0 * dl * da) / l
            ddb = (up - 2.0 * dl * db - l * da * da * sb * cb) / l
            ddl = along + l * (db * db + da * da * cb * cb)
            here = slice(6 + 3 * i, 9 + 3 * i)
            d.qpos[7 + 3 * i : 10 + 3 * i] = alpha, beta, l - self._l0[i]
            d.qvel[here] = da, db, dl
            d.qacc[here] = dda, ddb, ddl
            self._tips.append((r, (Q @ e.T) / np.array([l * cb, l, 1.0])))

    def inverse(self) -> None:
        """Call MuJoCo."""
        mujoco.mj_inverse(self.model, self.data)

    def leg_forces(self) -> Array:
        """Return tau (6,) N: the cut mechanism's forces brought to the platform, then to the closed legs."""
        Q = self.data.qfrc_inverse
        force, moment = Q[:3].copy(), self._R @ Q[3:6]
        for i, (r, to_base) in enumerate(self._tips):
            at_joint = to_base @ Q[6 + 3 * i : 9 + 3 * i]
            force += at_joint
            moment += np.cross(r, at_joint)
        J = jacobian_kernel(self._a, self._b, self._p, self._R)
        tau: Array = np.linalg.solve(J.T, np.concatenate((force, moment)))
        return tau


def _frame(s: Array) -> Array:
    """Return Q (3, 3), right-handed, whose third column is s."""
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(s)))], s)
    x /= np.sqrt(x @ x)
    return np.column_stack((x, np.cross(s, x), s))


def _xml(platform: Platform, l0: Array, frames: list[Array]) -> str:
    def text(values: Array | list[float]) -> str:
        return " ".join(repr(float(v)) for v in values)

    body, cylinder, rod = platform.platform, platform.cylinder, platform.rod
    I = body.inertia
    full = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]
    legs = "".join(
        f"""
    <body pos="{text(a)}" xyaxes="{text(Q[:, 0])} {text(Q[:, 1])}">
      <joint type="hinge" axis="1 0 0"/>
      <joint type="hinge" axis="0 1 0"/>
      <inertial pos="0 0 {cylinder.com!r}" mass="{cylinder.mass!r}"
        diaginertia="{cylinder.inertia_transverse!r} {cylinder.inertia_transverse!r} {THIN!r}"/>
      <body pos="0 0 {float(l)!r}">
        <joint type="slide" axis="0 0 1"/>
        <inertial pos="0 0 {-rod.com!r}" mass="{rod.mass!r}"
          diaginertia="{rod.inertia_transverse!r} {rod.inertia_transverse!r} {THIN!r}"/>
      </body>
    </body>"""
        for a, l, Q in zip(platform.base_joints, l0, frames, strict=True)
    )
    return f"""<mujoco>
  <compiler angle="radian"/>
  <option gravity="{text(platform.gravity)}"><flag constraint="disable"/></option>
  <worldbody>
    <body>
      <freejoint/>
      <inertial pos="{text(body.com)}" mass="{body.mass!r}" fullinertia="{text(full)}"/>
    </body>{legs}
  </worldbody>
</mujoco>"""
