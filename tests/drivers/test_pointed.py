"""Functions called by their address: a compiled one, and one in plain Python."""

import numpy as np
import pytest

from drivers.compiled.compiler import INTEGER, REAL, kernel, record
from drivers.compiled.pointed import call, data_at, of_python, pointed, reals_at, record_at

WORK = np.dtype([("function", "<i8"), ("context", "<i8"), ("into", "<f8", 2)])
LINE = np.dtype([("slope", "<f8"), ("points", "<i8"), ("count", "<i8")])
work_at = record_at(record(WORK, "into"))


@pointed(record(LINE), REAL, record(WORK, "into"))
def line(k, x, work):
    points = reals_at(k.points, k.count)
    work.into[0] = k.slope * x
    work.into[1] = points[-1]
    return k.count


@kernel(record(WORK))
def by_address(work):
    own = work_at(work.into.ctypes.data - 16)
    status = call(work.function, (work.context, 2.0, work.into.ctypes.data - 16))
    own.into[0] += 1.0
    return status


@pytest.fixture
def context():
    points = np.array([3.0, 4.0, 5.0])
    context = np.zeros((), LINE)
    context["slope"], context["points"], context["count"] = 10.0, data_at(points), 3
    return context, points


def test_a_compiled_function_runs_by_its_address_on_its_own_record(context):
    work = np.zeros((), WORK)
    work["function"], work["context"] = line.address, data_at(context[0])
    assert by_address(work) == 3
    assert work["into"].tolist() == [21.0, 5.0]


def test_the_same_function_can_be_called_from_python_with_records(context):
    work = np.zeros((), WORK)
    assert line(context[0], 0.5, work) == 3
    assert work["into"].tolist() == [5.0, 5.0]


def test_a_function_in_plain_python_runs_by_its_address():
    heard = []

    def function(context, x, where):
        heard.append((context, x, where))
        return 7

    work = np.zeros((), WORK)
    work["function"], keeps = of_python(function, INTEGER, REAL, INTEGER)
    work["context"] = 11
    assert by_address(work) == 7
    assert heard == [(11, 2.0, data_at(work))]
    assert keeps is not None
