"""`hil bus` with CAN FMUs on the kernel's CAN: frames as the kernel's own socket has them."""

import json
import os
import struct
import sys
from pathlib import Path

import pytest

from tests.network.can_nodes import build_node, demo_node
from tests.vcan import uml

ROOT = Path(__file__).resolve().parents[2]
pytestmark = [pytest.mark.vcan, pytest.mark.realtime(patient=True)]
RECEIVED, CONFIRMED = 1, 2
MS = 1_000_000


def frames(folder, name):
    """(identifier, flags of CAN FD, data) of each frame that the other node received."""
    found = []
    for line in (folder / f"{name}.frames").read_text().splitlines():
        content = bytes.fromhex(line.split()[1])
        identifier, size, flags = struct.unpack_from("=IBB", content)
        found.append((identifier, flags if len(content) == 72 else None, content[8 : 8 + size]))
    return found


def on_vcan(folder, runs):
    """Summaries of runs of `hil bus` inside a kernel with vcan0."""
    (folder / "runs.json").write_text(json.dumps(runs))
    command = [sys.executable, "-m", "tests.vcan.can_fmus", str(folder)]
    try:
        done = uml.run(command, limit_s=240.0, share=folder, kernel="any")
    except uml.UnavailableError as error:
        pytest.skip(f"NOT TESTED over SocketCAN: {error}")
    assert done.exit_code == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return {name: json.loads((folder / f"{name}.json").read_text()) for name in runs}


@pytest.mark.long
def test_can_fmus_exchange_frames_on_vcan0_with_each_other_and_another_node(tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    timed, stepped, fd = (
        str(build_node(tmp_path, each, countdown=own, PERIOD_NS=100 * MS, OFFSET_NS=100 * MS, **more))
        for each, own, more in ((0x100, True, {}), (0x200, False, {}), (0x111, True, {"CAN_FD": 1}))
    )
    runs = {
        "both": [timed, stepped, "--duration", "3"],
        "fd": [fd, timed, "--duration", "1"],
        "refused": [fd, "--duration", "1", "--classic"],
    }
    if has_demos := "HIL_LS_BUS_FMUS" in os.environ:
        demos = [str(demo_node(clock)) for clock in ("TriggeredOutput", "Countdown")]
        runs["demo"] = [*demos, "--duration", "1", "--classic"]
    summaries = on_vcan(tmp_path, runs)

    heard = frames(tmp_path, "both")
    for identifier, other in ((0x100, 0x200), (0x200, 0x100)):
        own = [data for each, _, data in heard if each == identifier]
        assert [data[0] for data in own] == list(range(30))
        there = sum(each == other for each, *_ in heard)
        assert own[-1][RECEIVED] in (there - 1, there, there + 1)  # with the frame of the other node
        assert own[-1][CONFIRMED] == 29
    assert summaries["both"]["frames"] == 60
    assert summaries["both"]["lateness"].keys() == {"median_us", "p99_us", "largest_us"}

    # 12 bytes with bit rate switch: CANFD_BRS 1 of linux/can.h, with CANFD_FDF 4 of newer kernels.
    long = [(flags, len(data)) for identifier, flags, data in frames(tmp_path, "fd") if identifier == 0x111]
    assert {(flags & 1, size) for flags, size in long} == {(1, 12)}
    assert len(long) == 10
    assert frames(tmp_path, "refused") == []
    (refused,) = summaries["refused"]["nodes"].values()
    assert refused["corrupt"] == 10  # each answered with a Format Error

    if has_demos:
        assert frames(tmp_path, "demo") == [(1, None, b"\1\2\3\4")] * 6
