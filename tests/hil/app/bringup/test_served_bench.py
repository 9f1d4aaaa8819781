"""A bench that is served: what it refuses."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator

import pytest

from drivers.errors import ConfigurationError
from hil.app.bringup.hands import hands_socket, served_bench
from hil.app.configuration.configuration import load
from hil.app.configuration.fault_words import with_faults
from plant_fmu.faults import FAULTS
from plant_fmu.faults.process import PROCESS

C = load("virtual")


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The path of a socket has 108 bytes."""
    with tempfile.TemporaryDirectory(prefix="hil-") as name:
        monkeypatch.setenv("XDG_RUNTIME_DIR", name)
        yield


WORDS = {
    **{name: f"{name} leg=2" for name in ("encoder_freeze", "encoder_lost", "drive_silence", "drive_reset")},
    "frames_loss": "frames_loss probability=0.5",
    "frames_forged_command": "frames_forged_command force=3",
    "bus_second_controller": "bus_second_controller rate=100",
    "plant_hang": "plant_hang for=1",
    "payload_step": "payload_step mass=100",
}


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("kind", WORDS)
def test_a_fault_that_would_never_strike_at_a_bench_is_refused_before_it_is_served(kind: str) -> None:
    assert not issubclass(FAULTS[kind], PROCESS)
    c = with_faults(C, ["process_slow by=1", WORDS[kind]])
    with (
        pytest.raises(ConfigurationError, match=rf"^plant\.faults\[1\]: {kind}: .*--mistake"),
        served_bench(c, []),
    ):
        pass
    assert not hands_socket(C.bus.interface, C.bus.channel).exists()


@pytest.mark.usefixtures("folder")
def test_the_faults_of_its_own_process_are_served_with_a_bench() -> None:
    faults = ["process_kill at=9", "process_stop at=3 for=0.1", "process_slow by=1"]
    with served_bench(with_faults(C, faults), []) as bench:
        assert bench.nodes.waiting == ()
