"""The order in which joint centres go round. Compiles nothing: the recorder draws by it."""

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Array

_PLANES = ((0, 1), (1, 2), (2, 0))
"""Of the axes of a frame, each from one towards the next."""


def around(joints: Array) -> NDArray[np.intp]:
    """Return the order (n,) of joints (n, 3) m by their angle about their centre, whatever plane they lie in.

    As seen along the axis of the frame along which they cover the largest area; from x towards y of a ring
    that is level.
    """
    x = joints - joints.mean(axis=0)
    moments = (x[:, :, None] * x[:, None, :]).sum(axis=0)
    areas = [moments[i, i] * moments[j, j] - moments[i, j] ** 2 for i, j in _PLANES]
    i, j = _PLANES[int(np.argmax(areas))]
    return np.argsort(np.arctan2(x[:, j], x[:, i]))
