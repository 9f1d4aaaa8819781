"""`hil adapter`: what it measures on links with injected latency and loss, and what follows in check and run."""

from __future__ import annotations

import math
import random
from collections.abc import Set as AbstractSet
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.arrays import Rows
from drivers.can.adapter import identity
from drivers.can.bus import Bus
from drivers.can.bus_time import BitTiming
from drivers.can.link import Link
from drivers.errors import ConfigurationError, RunError
from drivers.frame_array import received_array, sent_frames
from drivers.protocol import BRS, FD, Frame, Received
from hil.app.adapter import measure
from hil.app.adapter.budget import judge, stale_every_s
from hil.app.adapter.command import qualify
from hil.app.adapter.file import VERSION, Qualification, write_qualification
from hil.app.check.command import inspect
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, loads
from hil.cli import main
from tests.drivers.fake_links import ManualClock

QUIET = lambda *_: None  # noqa: E731


class SlowLink(Link):
    """A link to a peer: frames arrive after a random delay, or are lost. State: frames under way, losses."""

    virtual = True

    def __init__(
        self, clock: ManualClock, delay_us: tuple[float, float] = (0.0, 0.0), loss: float = 0.0, seed: int = 1
    ):
        self.clock, self._delay_us, self._loss = clock, delay_us, loss
        self._chance = random.Random(seed)
        self.peer, self.under_way, self.lost, self.sent, self.room = self, list[Received](), 0, 0, 10_000

    def send(self, frames: Rows) -> int:
        given = sent_frames(frames)[: self.room]
        for frame in given:
            delay_ns = round(1e3 * self._chance.uniform(*self._delay_us))
            if self._chance.random() < self._loss:
                self.lost += 1
            else:
                self.peer.under_way.append(Received(self.clock.now() + delay_ns, frame))
        self.sent += len(given)
        return len(given)

    def receive(self) -> Rows:
        now = self.clock.now()
        here = sorted(each for each in self.under_way if each.t_ns <= now)
        self.under_way = [each for each in self.under_way if each.t_ns > now]
        return received_array(here)

    def block(self, deadline_ns: int, missing: AbstractSet[int]) -> None:
        del missing
        next_ns = min((each.t_ns for each in self.under_way), default=deadline_ns)
        self.clock.sleep_until(min(next_ns, deadline_ns))


def ends(
    delay_us: tuple[float, float] = (0.0, 0.0), loss: float = 0.0
) -> tuple[Bus, Bus, SlowLink, SlowLink]:
    clock = ManualClock()
    near, far = (SlowLink(clock, delay_us, loss, seed) for seed in (1, 2))
    near.peer, far.peer = far, near
    return Bus([near]), Bus([far]), near, far


def test_latency_and_jitter_are_found_within_ten_percent():
    near, far, *_ = ends(delay_us=(200.0, 400.0), loss=0.01)
    found = measure.latencies_us(near, far, BitTiming(1_000_000, 5_000_000), QUIET)
    low, high = np.quantile(found, (0.01, 0.99))
    assert np.median(found) == pytest.approx(300.0, rel=0.1)
    assert (high - low) / 2 == pytest.approx(100.0, rel=0.1)
    assert found.max() <= 400.0


def test_every_lost_frame_of_both_directions_is_counted():
    near, far, a, b = ends(delay_us=(200.0, 400.0), loss=0.01)
    ours, theirs = measure.frames_of([(2, 0), (8, 0)]), measure.frames_of([(8, 0)] * 6)
    loss = measure.loss_at_rate(near, far, ours, theirs, 500.0, 5000, QUIET)
    assert loss.sent == 40_000 == a.sent + b.sent
    assert loss.lost == a.lost + b.lost
    assert loss.lost / loss.sent == pytest.approx(0.01, rel=0.1)


def test_queue_depth_is_the_number_of_frames_accepted_at_once():
    near, far, link, _ = ends()
    link.room = 10
    assert measure.queue_depth(near, far) == (10, True)
    link.room = 1000
    assert measure.queue_depth(near, far) == (128, False)


def test_can_fd_passes_only_with_its_bit_rate_switch(monkeypatch):
    near, far, link, _ = ends()
    assert measure.passes_fd(near, far)
    whole = link.send
    monkeypatch.setattr(link, "send", lambda frames: whole(_without(frames, BRS)))
    assert not measure.passes_fd(near, far)


def _without(frames: Rows, flag: int) -> Rows:
    changed = frames.copy()
    changed["flags"] &= ~np.uint8(flag)
    return changed


def test_no_frame_is_sent_on_a_bus_with_frames_of_others():
    near, _, link, _ = ends()
    link.under_way.append(Received(200_000_000, Frame(0x181, bytes(8))))
    with pytest.raises(RunError, match="0x181"):
        measure.require_quiet(near)
    assert link.sent == 0


def test_measurement_stops_when_others_begin_to_send():
    near, far, link, _ = ends()
    link.under_way.append(Received(2_000_000_000, Frame(0x181, bytes(8))))
    measure.require_quiet(near)
    frames = measure.frames_of([(8, 0)])
    with pytest.raises(RunError, match="0x181"):
        measure.loss_at_rate(near, far, frames, frames, 500.0, 5000, QUIET)
    assert link.sent < 1001


def test_measured_frames_are_not_extended_and_carry_zeros():
    frames = sent_frames(measure.frames_of([(12, FD | BRS | 1)] * 40))
    assert {frame.id for frame in frames} <= set(range(0x7C0, 0x7E0))
    assert {frame.flags for frame in frames} == {FD | BRS}
    assert {frame.data for frame in frames} == {bytes(12)}


def on_vcan(folder: Path, interface: str = "socketcan") -> Configuration:
    text = resources.files("configs").joinpath("socketcan.yaml").read_text(encoding="utf-8")
    text = text.replace("channel: can0", "channel: hilX").replace("e: socketcan", f"e: {interface}")
    return loads(text, "my.yaml", folder)


def qualification(**changes: object) -> Qualification:
    fine: dict[str, object] = {
        "kind": "adapter", "version": VERSION, "date": "2026-01-01T00:00:00+00:00", "interface": "socketcan",
        "channel": "hilX", "receiver": "hilX", "adapter": "missing", "kernel": "6.1", "rate_Hz": 500.0,
        "layout": "classic", "bitrate_bit_s": 1_000_000, "data_bitrate_bit_s": 5_000_000, "latency_us": 100.0,
        "jitter_us": 10.0, "worst_us": 200.0, "sent": 10_000, "lost": 0, "unsent": 0, "queue": 128,
        "queue_filled": False, "fd": "not used", "stamps": ["software"], "error_frames": 0, "overflows": 0,
        "restart_ms": 0, "recovery_ms": None,
    }  # fmt: skip
    return Qualification.model_validate(fine | changes)


@pytest.mark.parametrize(
    ("driver", "files", "identity_is"),
    [
        ("gs_usb", {"1-1/idVendor": "1d50\n", "1-1/idProduct": "606f\n", "1-1/serial": "0042\n",
                    "1-1/1-1:1.0/modalias": "usb:v1D50p606F\n"}, "gs_usb 1d50 606f 0042"),
        ("mcp251x", {"1-1/1-1:1.0/modalias": "spi:mcp2515\n"}, "mcp251x spi:mcp2515"),
    ],
)  # fmt: skip
def test_adapter_is_known_by_driver_and_hardware(tmp_path, driver, files, identity_is):
    """The tree of sysfs: a network interface links to its device, and that to its driver."""
    device = tmp_path / "sys/devices/1-1/1-1:1.0"
    (tmp_path / "sys/bus/drivers" / driver).mkdir(parents=True)
    device.mkdir(parents=True)
    for name, text in files.items():
        (tmp_path / "sys/devices" / name).write_text(text)
    (device / "driver").symlink_to(tmp_path / "sys/bus/drivers" / driver)
    (tmp_path / "sys/class/net/hilX").mkdir(parents=True)
    (tmp_path / "sys/class/net/hilX/device").symlink_to(device)
    assert identity(on_vcan(tmp_path).bus, tmp_path) == identity_is


# by the formula of ISO 11898-1: SYNC with 2 bytes 75 bits, six feedbacks of 8 bytes 135 bits each, at 1 Mbit/s
WIRE_US = 75 + 6 * 135
WINDOW_US = 1500
TABLE: list[tuple[dict[str, object], str, list[str]]] = [
    ({}, "", []),
    ({"latency_us": WINDOW_US - WIRE_US - 1.0, "worst_us": WINDOW_US - WIRE_US - 0.5}, "", []),
    ({"worst_us": WINDOW_US - WIRE_US + 1.0}, "", ["late at times"]),
    ({"latency_us": WINDOW_US - WIRE_US + 1.0, "worst_us": 9000.0}, "too slow", []),
    ({"lost": 100}, "", ["loses 1.00%"]),
    ({"queue": 8, "queue_filled": True}, "", ["accepts 8 frames"]),
    ({"queue": 9, "queue_filled": True}, "", []),
    ({"unsent": 1}, "", ["1 were refused"]),
    ({"fd": "failed"}, "", ["CAN FD"]),
]


@pytest.mark.parametrize(("changes", "refused", "warned"), TABLE)
def test_adapter_is_refused_or_warned_about_by_its_figures(tmp_path, changes, refused, warned):
    found = judge(on_vcan(tmp_path), 0, qualification(**changes))
    assert refused in found.refused
    assert bool(found.refused) == bool(refused)
    assert len(found.warnings) == len(warned)
    assert all(word in text for word, text in zip(warned, found.warnings, strict=True))


def test_time_between_stale_faults_agrees_with_a_simulation(tmp_path):
    """Six legs, lost SYNC and lost feedback; a fault after 4 ticks of a leg without feedback."""
    loss, rate_Hz, ticks = 0.2, 500.0, 400_000
    random_numbers = np.random.default_rng(7)
    missed = (random_numbers.random((ticks, 6)) < loss) | (random_numbers.random((ticks, 6)) < loss)
    runs = np.lib.stride_tricks.sliding_window_view(missed, 4, axis=0).all(axis=2)
    every_s = ticks / rate_Hz / runs.sum()
    assert stale_every_s(on_vcan(tmp_path), loss) == pytest.approx(every_s, rel=0.1)
    assert math.isinf(stale_every_s(on_vcan(tmp_path), 0.0))
    assert stale_every_s(on_vcan(tmp_path), 0.01) == pytest.approx(35 * 60, rel=0.03)


@pytest.mark.usefixtures("unproven")
def test_check_budgets_with_the_qualification_next_to_the_configuration(tmp_path):
    c, file = on_vcan(tmp_path), tmp_path / "adapter-hilX.yaml"
    assert "bus adapter" not in inspect(c).codes
    write_qualification(file, qualification(worst_us=620.0))
    report = inspect(c)
    assert report.codes.count("bus adapter") == 1
    assert report.figures["bus"]["adapter_us"] == WIRE_US + 620.0
    write_qualification(file, qualification(latency_us=620.0, worst_us=620.0))
    with pytest.raises(ConfigurationError, match="too slow"):
        inspect(c)
    file.write_text("kind: adapter\nversion: 1\n")
    with pytest.raises(ConfigurationError, match="adapter-hilX"):
        inspect(c)


@pytest.mark.usefixtures("unproven")
def test_check_warns_of_another_adapter_or_setting(tmp_path):
    write_qualification(tmp_path / "adapter-hilX.yaml", qualification(adapter="gs_usb", rate_Hz=100.0))
    (text,) = [w for w in inspect(on_vcan(tmp_path)).warnings if "hilX" in w]
    assert "adapter is missing, was gs_usb" in text
    assert "loop.rate_Hz is 500, was 100" in text


def test_run_warns_once_of_another_adapter(tmp_path):
    (tmp_path / "my.yaml").write_text(on_vcan(tmp_path).text)
    for adapter, warnings in (("gs_usb", 1), ("missing", 0)):
        write_qualification(tmp_path / "adapter-hilX.yaml", qualification(adapter=adapter))
        done = CliRunner().invoke(main, ["run", str(tmp_path / "my.yaml"), "--arm"])
        assert done.exit_code == 2
        assert done.output.count("is not as qualified") == warnings


def test_drive_with_an_identifier_of_the_measurement_is_refused(tmp_path):
    drives = {"protocol": "odrive", "node_ids": [1, 2, 3, 4, 5, 62], "transmission": {"lead_m": 0.02}}
    changes = {"drives": {**drives, "watchdog_ms": 40}, "loop": {"rate_Hz": 125}}
    c = loads(with_changes(on_vcan(tmp_path).text, changes), "my.yaml", tmp_path)
    with pytest.raises(ConfigurationError, match="0x7C"):
        qualify(c, channel=None, receiver=None, duration_s=0.01, tell=QUIET)


def test_localcan_is_measured_and_its_file_is_read_back(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr(measure, "SINGLES", 50)
    c = on_vcan(tmp_path, "localcan")
    lines, summary = qualify(c, channel=None, receiver=None, duration_s=0.1, tell=QUIET)
    assert len(lines) <= 20
    assert summary["lost"] == 0
    assert summary["sent"] == 50 * 9
    assert (tmp_path / "adapter-hilX.yaml").exists()
    assert summary["adapter"] == "localcan"
