"""Compares how the legs of an FMU and of the controller's model respond to pushes: order, sign, size."""

from itertools import combinations, permutations
from math import sqrt
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, Ints
from drivers.signals import LEGS
from hil.app.check.subject import Subject
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.app.derive_encoder_limits import believed_mass_kg
from hil.app.homing.last_pose import start_pose
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from hil.robot.kinematics_kernels import segment_distance
from plant_fmu.fmu.probe import Probe

NEAR = 0.02
"""Distance of two leg axes, as a share of the shortest leg, below which they probably cross by mistake."""
INSTANTS = 101
"""Number of instants of the reference at which leg axes are compared."""


def crossing(s: Subject) -> str:
    """Text about the two legs whose axes come nearest, if too near; else "". Shared joints do not count."""
    a, b = s.model.platform.base_joints, s.model.platform.platform_joints
    ends = s.span_s * (1 - 1e-12)
    path = [s.trajectory.sample(t)[:2] for t in np.linspace(0.0, ends, INSTANTS).tolist()]
    found = []
    for p, R in [pose_arrays(s.c.platform.home), *path]:
        tips = p + b @ R.T
        legs = tips - a
        near = NEAR * float(np.linalg.norm(legs, axis=1).min())
        for i, j in combinations(range(LEGS), 2):
            if min(np.linalg.norm(a[i] - a[j]), np.linalg.norm(tips[i] - tips[j])) > near:
                apart = segment_distance(*map(tuple, (a[i], legs[i], a[j], legs[j])))
                found += [(apart, i, j)] * (apart < near)
    if not found:
        return ""
    apart, i, j = min(found)
    return f"{i} and {j} come within {1e3 * apart:.2g} mm"


UNLIKE = 0.1
"""Relative difference of two responses, each scaled to length 1, from which on they are not the same."""
LIKE = 0.3
"""Relative difference up to which another order of legs may explain a response."""
OTHER = 0.05
"""Relative difference of accelerations above which `hil check` warns."""
_ORDERS = np.array(list(permutations(range(LEGS))))
_SHIFTED = [((np.arange(LEGS) + k) % LEGS != _ORDERS).sum(axis=1) + (k > 0) for k in range(LEGS)]
_COSTS = np.min(_SHIFTED, axis=0)
"""Number of mistakes that make an order: a shift of all legs is one, each other leg one more."""


class Match(NamedTuple):
    """Order and signs of the legs under which one response matrix is most like another."""

    keys: int
    """Reordered keys of the FMU: 0 forces and outputs, 1 forces, 2 outputs."""
    order: Ints
    """(6,): leg k of the first matrix responds like leg order[k] of the second."""
    sign: Array
    """(6,) 1 or -1."""

    def undo(self, K: Array) -> Array:
        """Reorder a response matrix K (6, 6) into the order and signs of the other matrix."""
        back = np.argsort(self.order)
        if self.keys == 0:
            return K[np.ix_(back, back)]
        return (K * self.sign)[:, back] if self.keys == 1 else (K * self.sign[:, np.newaxis])[back]


def match(K: Array, K0: Array) -> Match:
    """Find the order and signs of legs that make a response K (6, 6) most like K0 at any scale.

    Tried are all orders of both rows and columns, and of either with its best signs. Of those that fit about
    best, the one with the fewest mistakes is taken, and the given one unless it fits far worse.
    """
    by_force = np.einsum("ab,anb->nb", K, K0[:, _ORDERS])
    by_rate = np.einsum("ab,nab->na", K, K0[_ORDERS])
    both = np.einsum("ab,nab->n", K, K0[_ORDERS[:, :, np.newaxis], _ORDERS[:, np.newaxis, :]])
    signs = [np.ones_like(by_force), *(np.where(each < 0.0, -1.0, 1.0) for each in (by_force, by_rate))]
    fits = np.stack([both, np.abs(by_force).sum(axis=1), np.abs(by_rate).sum(axis=1)])
    cosines = fits.clip(min=0.0) / (np.linalg.norm(K) * np.linalg.norm(K0))
    unlike = np.sqrt((1.0 - cosines**2).clip(min=0.0))
    given, best = unlike[0, 0], unlike.min()
    if given <= max(UNLIKE, 2.0 * best) or best > LIKE:
        return Match(1, _ORDERS[0], np.where(np.diag(K) < 0.0, -1.0, 1.0))
    costs = np.stack([_COSTS + (each < 0.0).sum(axis=1) for each in signs])
    costs[unlike > 1.2 * best + 0.01] = costs.max() + 1  # that do not fit about best
    keys, n = np.unravel_index(costs.argmin(), costs.shape)
    return Match(int(keys), _ORDERS[n], signs[keys][n])


def _unlike(K: Array, K0: Array) -> float:
    cosine = max(float((K * K0).sum()), 0.0) / float(np.linalg.norm(K) * np.linalg.norm(K0))
    return sqrt(max(1.0 - cosine**2, 0.0))


def model_mobility(c: Configuration) -> Array:
    """Mobility J M^-1 J^T (6, 6) 1/kg of the legs by the controller's model, at the plant's start pose."""
    pose = pose_arrays(start_pose(c))
    platform = build_platform(c.platform)
    model = Model(platform, leg_spin=c.platform.leg_spin, reflected_mass=believed_mass_kg(c))
    J = jacobian(platform, *pose)
    mobility: Array = J @ np.linalg.solve(model.mass_matrix(*pose), J.T)
    return mobility


def findings(found: Probe, K0: Array) -> list[str]:
    """Sentences on implausible responses of an FMU to pushes. K0: (6, 6) 1/kg, mobility of the model."""
    K, uncoupled = found.mobility, bool(found.uncoupled)
    still = np.flatnonzero(~K.any(axis=0) | ~K.any(axis=1))
    if len(still):
        what = f"a push of leg {_listed(still)} of the FMU moves no leg within a period, or no push moves it"
        return [f"{what}: check the map of plant.model, dry friction, and the step of the FMU itself"]
    moved, expected = found.moved, K0
    if uncoupled:  # of any masses
        K, moved = (np.sign(each) * (np.abs(each) > 0.5 * np.abs(each).max(axis=0)) for each in (K, moved))
        expected = np.eye(LEGS)
    rates = match(K, expected)
    lengths = match(moved, expected) if moved.any() else rates
    same = (rates.order == lengths.order) & (rates.sign == lengths.sign)
    if rates.keys == lengths.keys and same.all():
        sentences = _mistakes(rates, "length and rate")
    else:
        sentences = _mistakes(rates, "rate") + _mistakes(lengths, "length")
    if uncoupled:
        return sentences
    A = rates.undo(K)
    ratio, unlike = np.diag(A) / np.diag(K0), _unlike(A, K0)
    if np.abs(ratio - 1.0).max() > OTHER or unlike > UNLIKE:
        least, most = f"{ratio.min():.2f}", f"{ratio.max():.2f}"
        times = least if least == most else f"{least} to {most}"
        sentences.append(
            f"the FMU's legs accelerate {times} times as much as the model's by the same force, and the "
            f"pattern of all responses differs by {100.0 * unlike:.0f} %: compare masses and inertias of "
            "section platform, controller.model.reflected_mass_kg, and the lag of the force in the FMU"
        )
    return sentences


def _mistakes(found: Match, outputs: str) -> list[str]:
    sentences, legs = [], np.flatnonzero(found.order != np.arange(LEGS))
    keys = (f"force, {outputs.replace(' and', ',')} and brake", "force", outputs)[found.keys]
    if len(legs):
        first, *more = legs.tolist()
        others = f" ({', '.join(f'{leg} as {found.order[leg]}' for leg in more)})" if more else ""
        sentences.append(
            f"leg {first} of the FMU answers as leg {found.order[first]} of section platform{others}: "
            f"is the order of plant.model.{keys} right?"
        )
    if len(turned := np.flatnonzero(found.sign < 0.0)):
        both = found.keys == 1 and outputs == "length and rate"
        wrong = outputs if found.keys == 1 else keys
        what = "a force > 0 shortens" if both else f"plant.model.{wrong} has the wrong sign of"
        sentences.append(
            f"{what} leg {_listed(turned)} of the FMU: > 0 has to extend it, change it in the FMU"
        )
    return sentences


def _listed(legs: Ints) -> str:
    return ", ".join(map(str, legs.tolist()))
