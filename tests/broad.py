"""Test cases that run every time, and those that run only in `make long`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def broad(cases: Iterable[Any], quick: int) -> list[Any]:
    """Cases of a parameter; all but the first `quick` are marked as long."""
    return [case if k < quick else _long(case) for k, case in enumerate(cases)]


def _long(case: Any) -> Any:
    mark = pytest.mark.long
    if isinstance(case, type(pytest.param())):
        return pytest.param(*case.values, marks=[*case.marks, mark], id=case.id)
    return pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=mark)
