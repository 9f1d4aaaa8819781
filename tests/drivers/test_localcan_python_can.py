"""localcan under python-can: its bus and logger."""

from __future__ import annotations

import asyncio
import errno
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import can
import pytest

from drivers.can.localcan.interface import LocalCanBus
from drivers.can.localcan.participant import Participant
from drivers.frame_array import sent_array
from drivers.protocol import BRS, FD, Frame

pytestmark = pytest.mark.usefixtures("runtime")


def next_message(bus: can.BusABC) -> can.Message:
    received = bus.recv(1.0)
    assert received is not None
    return received


def message(identifier, data=b"", **options):
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=False, **options)


def test_python_can_finds_the_localcan_interface_by_its_entry_point():
    with (
        can.Bus("t", "localcan", bitrate=1_000_000, data_bitrate=5_000_000, fd=True, ignore_config=True) as a,
        can.Bus("t", "localcan", receive_own_messages=True, ignore_config=True) as b,
    ):
        assert isinstance(a, LocalCanBus)
        assert b.protocol == can.CanProtocol.CAN_FD
        before = time.time()
        a.send(message(0x42, bytes(12), is_fd=True, bitrate_switch=True))
        got = next_message(b)
        assert before <= got.timestamp <= time.time()
        assert (got.arbitration_id, got.is_fd, got.bitrate_switch, got.dlc) == (0x42, True, True, 12)
        assert got.is_rx
        b.send(message(0x43))
        assert not next_message(b).is_rx
        assert next_message(a).arbitration_id == 0x43
        b.send(can.Message(is_error_frame=True))
        assert next_message(a).is_error_frame
        a.set_filters([{"can_id": 0x50, "can_mask": 0x7FF}])
        b.send(message(0x4F))
        b.send(message(0x50))
        assert next_message(a).arbitration_id == 0x50


def test_localcan_refuses_different_bit_rates_a_full_queue_and_fd_frames_on_a_classic_bus():
    with LocalCanBus("t", bitrate=125_000, fd=False) as bus:
        with pytest.raises(can.CanInitializationError, match="125000"):
            LocalCanBus("t", bitrate=250_000)
        with pytest.raises(can.CanOperationError) as caught:  # noqa: PT012 - the 65th or a later one
            for _ in range(200):
                bus.send(message(0x1, bytes(8)))
        assert caught.value.error_code == errno.ENOBUFS
        bus.flush_tx_buffer()
        with pytest.raises(can.CanOperationError, match="classic"):
            bus.send(message(0x1, is_fd=True))


def test_asyncio_reader_gets_all_localcan_messages_through_the_file_descriptor():
    async def run() -> list[int]:
        with LocalCanBus("t", bitrate=1_000_000, fd=False) as a, LocalCanBus("t") as b:
            reader = can.AsyncBufferedReader()
            notifier = can.Notifier(b, [reader], loop=asyncio.get_running_loop())
            for k in range(50):
                a.send(message(0x100 + k, bytes(8)))
                await asyncio.sleep(0.005 * (k % 10 == 0))
            found = [await asyncio.wait_for(reader.get_message(), 2) for _ in range(50)]
            notifier.stop()
            return [each.arbitration_id for each in found]

    assert sorted(asyncio.run(run())) == list(range(0x100, 0x100 + 50))


@contextmanager
def on_the_bus(
    node: Participant, program: str, *options: str, **pipes: Any
) -> Iterator[subprocess.Popen[bytes]]:
    """Run a program of python-can until it has joined the channel; kill it at the end."""
    # SIGINT is ignored if the tests run in the background; the child would inherit this
    start = (
        "import runpy, signal; signal.signal(signal.SIGINT, signal.default_int_handler);"
        f"runpy.run_module({program!r}, run_name='__main__')"
    )
    process = subprocess.Popen([sys.executable, "-c", start, "-i", "localcan", "-c", "t", *options], **pipes)
    try:
        deadline = time.monotonic() + 15
        while len(node._wire.present()) < 2:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        yield process
    finally:
        process.kill()
        process.wait(10)


def test_logger_of_python_can_records_a_localcan_bus(join, tmp_path):
    node, path = join(), tmp_path / "bus.log"
    with on_the_bus(node, "can.logger", "-f", str(path), stdout=subprocess.DEVNULL) as logger:
        node.send(sent_array([Frame(0x100 + i, bytes([i] * 12), FD | BRS) for i in range(50)]))
        time.sleep(0.3)
        logger.send_signal(signal.SIGINT)
        assert logger.wait(10) == 0
    with can.LogReader(path) as log:
        found = [(m.arbitration_id, bytes(m.data)) for m in log]
    assert found == [(0x100 + i, bytes([i] * 12)) for i in range(50)]
    assert len(node._wire.present()) == 1
