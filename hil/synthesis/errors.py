"""The refusal of the synthesis."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from drivers.errors import ModelError


class SynthesisError(ModelError):
    """A design that no controller fulfils, or a problem that is not well posed."""


@contextmanager
def computable() -> Iterator[None]:
    """Refuse numbers at which the algebra inside gives up, or warns: SciPy does near a singular matrix.

    Raises SynthesisError.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            yield
    except (np.linalg.LinAlgError, Warning) as error:
        raise SynthesisError(
            f"the numbers of the design are too far apart to compute with ({error}), allowed: weights of one "
            "loop; look for a wrong unit"
        ) from None
