"""Numbers as the page reads them: 32 bit floats in base 64."""

import base64

import numpy as np
from numpy.typing import ArrayLike


def packed(values: ArrayLike) -> str:
    """Return any array as little-endian float32 in base 64, row by row; what is not finite becomes nan."""
    with np.errstate(over="ignore", invalid="ignore"):
        narrow = np.asarray(values, np.float64).astype("<f4").ravel()
    narrow[~np.isfinite(narrow)] = np.nan
    return base64.b64encode(narrow.tobytes()).decode("ascii")
