"""Public names of `hil`: a stable list, without compilation, typed."""

import subprocess
import sys

import pytest

import hil
from hil.record import Recording
from tests.hil.samples import random_ticks, record

STABLE = [
    "Answer", "BusError", "Column", "ConfigurationError", "Event", "Frame", "HilError", "Log", "LogError", "LogStatistics",
    "LoggedFrame", "ModelError", "OperatorClient", "PlantError", "ProtocolError", "Received", "Run", "RunError", "SetPoint",
    "Streamed", "Tick", "sim",
]  # fmt: skip


def test_public_names_of_the_package_equal_a_fixed_list():
    assert hil.__all__ == STABLE
    assert set(STABLE) <= set(dir(hil))


@pytest.mark.parametrize("name", STABLE)
def test_each_public_object_is_documented_and_has_its_own_name(name):
    thing = getattr(hil, name)
    assert thing.__name__ == name
    assert thing.__doc__


def test_unknown_name_of_the_package_is_refused():
    with pytest.raises(AttributeError, match="no attribute 'Lag'"):
        _ = hil.Lag


def test_each_package_is_marked_as_typed():
    for package in ("hil", "drivers", "plant_fmu"):
        home = __import__(package).__path__[0]
        with open(f"{home}/py.typed") as file:  # noqa: PTH123
            assert file.read() == ""


def test_reading_a_log_imports_neither_numba_nor_scipy(tmp_path):
    with Recording.start(tmp_path / "a.mcap", configuration="", lockstep=True) as recording:
        record(recording, random_ticks(300))
    script = """
import sys, hil
log = hil.Log(sys.argv[1])
assert log.columns and log.summary.ticks == 300 and log.cut == ""
assert log.frame("mode", "tau").shape == (300, 7)
assert len(log.rows()) == sum(len(block) for block in log.blocks()) == 300
assert sum(1 for _ in log.can_frames()) > 300 and log.events() == [] and len(list(log.ticks())) == 300
print(sorted({name.split(".")[0] for name in sys.modules} & {"numba", "llvmlite", "scipy", "can", "matplotlib"}))
"""
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path / "a.mcap")],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (done.stdout, done.returncode) == ("[]\n", 0), done.stderr
