"""Runs inside a kernel with CAN: `SocketCan` against interfaces, queues and errors made by the kernel.

``socketcan_cases.py RESULT NAME ...``: writes the result of each case to RESULT as JSON, {name: [seconds, error]}.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import socket
import struct
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from drivers.can import netlink
from drivers.can.adapter import time_stamps
from drivers.can.link import collect
from drivers.can.socketcan import SocketCan
from drivers.config import BusSettings
from drivers.errors import BusError
from drivers.frame_array import received_frames, sent_array
from drivers.protocol import BRS, ERROR, ESI, FD, Frame, Received
from drivers.signals import BusState
from tests.vcan import kernel

NEAR, FAR = "hilA", "hilB"
OLD, NEW = Frame(0x100, b"old"), Frame(0x200, b"new")


def settings(channel: str = NEAR, **changes: object) -> BusSettings:
    given = {"interface": "socketcan", "channel": channel, "layout": "classic", **changes}
    return BusSettings.model_validate(given)


def opened(of: BusSettings | None = None) -> contextlib.closing[SocketCan]:
    return contextlib.closing(SocketCan(of or settings()))


def soon(seconds: float = 0.5) -> int:
    return time.monotonic_ns() + round(seconds * 1e9)


def refused(call: Callable[[], object]) -> str:
    """Message of the BusError that a call raises."""
    try:
        call()
    except BusError as error:
        return str(error)
    raise AssertionError("not refused")


def identifiers(frames: list[bytes]) -> list[int]:
    return [struct.unpack_from("=I", each)[0] for each in frames]


def bus_with_a_temporarily_full_queue_is_not_off() -> None:
    with kernel.pair(NEAR, FAR), kernel.raw_socket(FAR) as far, opened() as can:
        kernel.plug(NEAR, 4)
        taken = can.send(sent_array([OLD] * 6))
        assert taken == 4, f"{taken} of 6 taken with room for 4"
        assert not can.off
        kernel.unplug(NEAR)
        assert can.send(sent_array([NEW])) == 1
        assert not can.off
        assert identifiers(kernel.heard(far)) == [0x100] * 4 + [0x200]


def dead_bus_is_off_in_time_and_sends_no_old_command_afterwards() -> None:
    with kernel.pair(NEAR, FAR), kernel.raw_socket(FAR) as far, opened() as can:
        can.send(sent_array([OLD]))
        assert identifiers(kernel.heard(far)) == [0x100]
        kernel.plug(NEAR, 1000)
        begun = time.monotonic()
        while not can.off:
            assert time.monotonic() - begun < 1.0
            can.send(sent_array([OLD]))
            time.sleep(0.01)
        took = time.monotonic() - begun
        can.died()
        assert 0.045 < took < 0.15, f"off after {took:.3f} s"
        index = socket.if_nametoindex(NEAR)
        assert netlink.queued(index) == 0, "old commands wait"
        kernel.unplug(NEAR)
        assert can.send(sent_array([NEW])) == 1
        assert identifiers(kernel.heard(far)) == [0x200]
        assert not can.off


def stale_frames_are_refused_before_arming_without_cap_net_admin() -> None:
    with kernel.pair(NEAR, FAR), kernel.raw_socket(NEAR) as another:
        kernel.plug(NEAR, 1000)
        for _ in range(3):
            another.send(struct.pack("=IB3x8s", 0x100, 3, b"old"))
        with opened() as can:
            assert "CAP_NET_ADMIN" not in can.facts
            child = os.fork()
            if not child:
                os._exit(_refuses_stale_frames(can))
            _, status = os.waitpid(child, 0)
            assert os.waitstatus_to_exitcode(status) == 0
            assert netlink.queued(socket.if_nametoindex(NEAR)) == 3
            can.flush_tx()
            assert netlink.queued(socket.if_nametoindex(NEAR)) == 0


def _refuses_stale_frames(can: SocketCan) -> int:
    """Give up all capabilities, and try to begin on the dead bus."""
    header, nothing = struct.pack("=Ii", 0x20080522, 0), bytes(24)
    if ctypes.CDLL(None).capset(header, nothing):
        return 2
    try:
        can.flush_tx()
    except BusError as error:
        return 0 if "stale frames" in str(error) and "CAP_NET_ADMIN" in can.facts else 3
    return 4


def bus_is_off_while_its_interface_is_down() -> None:
    with kernel.pair(NEAR, FAR), kernel.raw_socket(FAR) as far, opened() as can:
        kernel.up(NEAR, on=False)
        assert can.send(sent_array([OLD])) == 0
        assert can.off
        received_frames(can.receive())
        assert can.off
        why = refused(can.flush_tx)
        assert "is down" in why
        kernel.up(NEAR)
        can.flush_tx()
        received_frames(can.receive())
        assert can.send(sent_array([NEW])) == 1
        far.send(kernel.FRAME.pack(0x300, 0, b""))
        assert [r.frame.id for r in received_frames(collect(can, soon()))] == [0x300]
        assert not can.off
        assert identifiers(kernel.heard(far)) == [0x200]


def bus_is_off_until_its_deleted_interface_is_made_again() -> None:
    with kernel.pair(NEAR, FAR), opened() as can:
        kernel.delete(NEAR)
        received_frames(can.receive())
        assert can.send(sent_array([OLD])) == 0
        assert can.off
        kernel.make_pair(NEAR, FAR)
        with kernel.raw_socket(FAR) as far:
            time.sleep(0.11)
            assert can.send(sent_array([NEW])) == 1
            can.flush_tx()
            assert not can.off
            assert identifiers(kernel.heard(far)) == [0x200]


def frames_not_read_in_time_are_counted() -> None:
    sent = 4000
    with kernel.pair(NEAR, FAR), kernel.raw_socket(FAR) as far, opened() as can:
        raw = kernel.FRAME.pack(0x300, 8, bytes(8))
        for _ in range(sent):
            far.send(raw)
        got = len(received_frames(can.receive()))
        while more := len(received_frames(can.receive())):
            got += more
        assert got < sent, "nothing was lost: more frames are needed"
        # the kernel reports losses with the next frame
        far.send(raw)
        got += len(received_frames(collect(can, soon())))
        assert can.overflow == sent + 1 - got


def can_fd_flags_are_sent_and_received() -> None:
    flags = (FD, FD | BRS, FD | ESI, FD | BRS | ESI)
    frames = [Frame(0x180 + i, bytes(range(12)), each) for i, each in enumerate(flags)]
    near = settings(layout="fd")
    with kernel.pair(NEAR, FAR), kernel.raw_socket(FAR, fd=True) as far, opened(near) as can:
        assert can.send(sent_array(frames)) == 4
        raw = kernel.heard(far)
        # byte 5 of struct canfd_frame: BRS 1, ESI 2
        assert [len(each) for each in raw] == [72] * 4
        assert [each[5] & 3 for each in raw] == [0, 1, 2, 3]
        for each in raw:
            far.send(each)
        received = received_frames(collect(can, soon(), {frame.id for frame in frames}))
        assert [r.frame for r in received] == frames


def corrupted_frames_affect_no_other_frames() -> None:
    sent = 600
    with kernel.pair(NEAR, FAR), kernel.raw_socket(FAR) as far, opened() as can:
        kernel.corrupt(FAR, 0.5)
        raw = kernel.FRAME.pack(0x123, 8, bytes(8))
        got: list[Received] = []
        for _ in range(sent // 100):
            for _ in range(100):
                far.send(raw)
            got += received_frames(can.receive())
        whole = sum(r.frame == Frame(0x123, bytes(8)) for r in got)
        # half are left alone; a flipped bit makes another identifier, other data, another length, or an
        # error frame, or the kernel drops it
        assert 200 < whole < 500, whole
        assert whole < len(got) <= sent


def adapter_at_another_bit_rate_is_refused() -> None:
    adapter = kernel.Adapter(500_000)
    try:
        why = refused(lambda: SocketCan(settings(adapter.name)).close())
        assert "500000" in why
        assert "bus.bitrate_bit_s is 1000000" in why
        slow = settings(adapter.name, bitrate_bit_s=500_000, options={"restart_ms": 0})
        with opened(slow) as can:
            assert "500000 bit/s, state ACTIVE, restart-ms 0" in can.facts, can.facts
    finally:
        adapter.close()


def can_controller_states_are_followed_to_bus_off_and_back() -> None:
    adapter = kernel.Adapter(1_000_000)
    try:
        with opened(settings(adapter.name)) as can:
            found = []
            for line in (b"sw100000", b"sp130128", b"sa000000", b"e1c", b"sb256256"):
                adapter.says(line)
                received = received_frames(collect(can, soon(0.05)))
                assert [r.frame.flags & ERROR for r in received] == [ERROR]
                found.append((can.worst_state(), can.off))
            assert found == [
                (BusState.WARNING, False),
                (BusState.PASSIVE, False),
                (BusState.PASSIVE, False),
                (BusState.ACTIVE, False),
                (BusState.OFF, True),
            ], found
            why = refused(lambda: SocketCan(settings(adapter.name)).close())
            assert "bus-off" in why
            assert can.send(sent_array([OLD])) == 0
            can.flush_tx()
            assert not can.off
            assert can.send(sent_array([NEW])) == 1
            kernel.wait_until(lambda: any(line.startswith(b"t200") for line in adapter.lines))
            assert not any(line.startswith(b"t100") for line in adapter.lines), adapter.lines
    finally:
        adapter.close()


def virtual_interface_has_the_time_stamps_of_the_kernel() -> None:
    of = settings(options={"hardware_stamps": True})
    with kernel.pair(NEAR, FAR), kernel.raw_socket(FAR) as far, opened(of) as can:
        assert "time stamps of the kernel: the driver gives no others" in can.facts
        before = time.monotonic_ns()
        far.send(kernel.FRAME.pack(0x300, 0, b""))
        time.sleep(0.1)
        (frame,) = received_frames(can.receive())
        assert -1_000_000 < frame.t_ns - before < 50_000_000, frame.t_ns - before
        stamps = time_stamps(FAR, lambda: can.send(sent_array([NEW])))
        assert stamps == ["software"], stamps


CASES = {
    function.__name__: function
    for function in (
        bus_with_a_temporarily_full_queue_is_not_off,
        dead_bus_is_off_in_time_and_sends_no_old_command_afterwards,
        stale_frames_are_refused_before_arming_without_cap_net_admin,
        bus_is_off_while_its_interface_is_down,
        bus_is_off_until_its_deleted_interface_is_made_again,
        frames_not_read_in_time_are_counted,
        can_fd_flags_are_sent_and_received,
        corrupted_frames_affect_no_other_frames,
        adapter_at_another_bit_rate_is_refused,
        virtual_interface_has_the_time_stamps_of_the_kernel,
        can_controller_states_are_followed_to_bus_off_and_back,
    )
}


def main() -> None:
    """Run the cases one after the other; a failed case does not stop the others."""
    results: dict[str, object] = {}
    for name, case in CASES.items():
        begun, trouble = time.monotonic(), ""
        try:
            case()
        except Exception:  # noqa: BLE001 - whatever it is, the test outside shows it
            trouble = traceback.format_exc()
        results[name] = [time.monotonic() - begun, trouble]
        Path(sys.argv[1]).write_text(json.dumps(results))


if __name__ == "__main__":
    main()
