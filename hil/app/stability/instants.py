"""The instants of a reference at which the robot is looked at."""

import numpy as np

from drivers.errors import ConfigurationError, HilError
from hil.app.configuration.configuration import Configuration
from hil.app.reachability import span_s
from hil.trajectory.build import build_trajectory
from hil.trajectory.path import PoseSample

SAMPLES, APART_s = 101, 0.02
"""Least instants, and their distance on a long reference, s."""
MOST = 501
GOLDEN = 0.6180339887498949


def instants(c: Configuration) -> list[PoseSample]:
    """Return the reference at instants of even distance, or of uneven where few; one where it rests.

    Raises ConfigurationError where it cannot be followed.
    """
    try:
        trajectory = build_trajectory(c.reference, c.platform.home, c.folder)
        span = span_s(trajectory)
        count = min(max(SAMPLES, round(span / APART_s)), MOST)
        # Just inside the end, where the path still moves: outside it rests.
        times = np.linspace(0.0, span * (1 - 1e-12), count if span > 0.0 else 1)
        if count == MOST:  # what repeats in step with even distances would not be seen
            times[1:-1] += (np.arange(1, MOST - 1) * GOLDEN % 1.0 - 0.5) * times[1]
        path = [PoseSample(*(np.array(part) for part in trajectory.sample(float(t)))) for t in times]
    except ConfigurationError:
        raise
    except HilError as error:
        raise ConfigurationError(f"{c.source}: reference: {error}") from error
    moves = any(np.abs(s.twist).max() > 0.0 or np.abs(s.dtwist).max() > 0.0 for s in path)
    return path if moves else path[:1]
