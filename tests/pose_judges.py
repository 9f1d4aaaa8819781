"""Python functions that judge poses, callable by address as a live trajectory calls them."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np

from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import Callee, of_python


def judged(judge: Callable[[Any], int]) -> Callee:
    """Judge of six words, by address."""

    def called(_context: int, words: int) -> int:
        return int(judge(np.array((ctypes.c_double * 6).from_address(words))))

    address, keeps = of_python(called, INTEGER, INTEGER)
    return Callee(address, 0, keeps)


ANYWHERE = judged(lambda _: 0)
"""Admits every pose."""
