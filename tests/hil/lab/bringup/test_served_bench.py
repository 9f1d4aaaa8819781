"""A bench that is served: what it refuses, and that no request of a stranger ends it."""

from __future__ import annotations

import contextlib
import socket
import tempfile
from collections.abc import Iterator

import pytest

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import load
from hil.app.configuration.fault_words import with_faults
from hil.app.plant import Bench
from hil.lab.bringup.hands import hands_socket, served_bench
from plant_fmu.faults import FAULTS
from plant_fmu.faults.kinds import PROCESS

C = load("virtual")


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The path of a socket has 108 bytes."""
    with tempfile.TemporaryDirectory(prefix="hil-") as name:
        monkeypatch.setenv("XDG_RUNTIME_DIR", name)
        yield


@pytest.fixture
def stranger() -> Iterator[socket.socket]:
    """A socket without a name of its own: nobody can answer it."""
    with contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as door:
        yield door


def ask(bench: Bench, door: socket.socket, request: bytes) -> None:
    door.sendto(request, str(hands_socket(C.bus.interface, C.bus.channel)))
    bench.hands()


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


@pytest.mark.usefixtures("folder")
def test_who_has_no_address_is_not_answered_and_the_bench_goes_on(stranger: socket.socket) -> None:
    with served_bench(C, []) as bench:
        ask(bench, stranger, b'["weigh", -1, 0.0]')
        ask(bench, stranger, b'["place", 3, 1.0]')
        bound = f"{hands_socket(C.bus.interface, C.bus.channel)}-me"
        stranger.bind(bound)
        ask(bench, stranger, b'["measure", 3, 0.0]')
        stranger.setblocking(False)
        # the end of a stroke of 0.75 to 2.2 m: what was asked without an address was done
        assert float(stranger.recv(100)) == pytest.approx(2.2, abs=1e-3)


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    "request_",
    [
        b'["weigh", Infinity, 0]',
        b'["weigh", 1e999, 0]',
        b'["weigh", -1, ' + b"1" * 400 + b"]",
        b'["hang", -1, 1000]',
        b"[" * 4096,
    ],
    ids=["no leg", "a leg without end", "no number", "no such pose", "too deep"],
)
def test_a_request_that_means_nothing_does_not_end_a_bench(stranger: socket.socket, request_: bytes) -> None:
    with served_bench(C, []) as bench:
        stranger.bind(f"{hands_socket(C.bus.interface, C.bus.channel)}-me")
        stranger.setblocking(False)
        ask(bench, stranger, request_)
        with pytest.raises(BlockingIOError):
            stranger.recv(100)
        ask(bench, stranger, b'["read_way", -1, 0]')
        assert float(stranger.recv(100)) == 1.0
