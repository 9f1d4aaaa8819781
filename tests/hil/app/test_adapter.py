"""`hil adapter`: what it measures on links with injected latency and loss, and what follows in check and run."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from collections.abc import Set as AbstractSet
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.arrays import Rows
from drivers.can import netlink
from drivers.can.adapter import identity
from drivers.can.bus import Bus
from drivers.can.bus_time import BitTiming
from drivers.can.link import Link
from drivers.errors import ConfigurationError, LogError, RunError
from drivers.frame_array import received_array, sent_frames
from drivers.protocol import BRS, EXTENDED, Frame, Received
from hil.app.adapter import measure
from hil.app.adapter.measure import of_interface, qualify
from hil.app.adapter.qualification import VERSION, Qualification, judge, stale_every_s
from hil.app.check.command import inspect
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, loads
from hil.app.configuration.section_file import write_section
from hil.cli import main
from tests.drivers.fake_links import ManualClock
from tests.hil.app.test_doctor import link
from tools.drive_families import FAMILIES as FAMILY_CHANGES

QUIET = lambda *_: None  # noqa: E731


ROOT = Path(__file__).parents[3]
LEGS_LISTEN = {0x001, 0x080, 0x100, 0x101, 0x110, 0x111, 0x120, *range(0x601, 0x607)}
RMD: dict[str, Any] = {
    "drives": {
        "protocol": "dbc",
        "watchdog_ms": 25,
        "options": {
            "variant": None, "model": None, "dbc": "rmd.dbc", "position": "Answer.Angle", "velocity": "Speed",
            "current": "Answer.Current", "command": "TorqueCurrent", "torque_constant_Nm_A": 2.0,
            "poll": "9c00000000000000", "disable": "8100000000000000",
        },
    },
    "loop": {"rate_Hz": 200},
}  # fmt: skip


class SlowLink(Link):
    """A link to a peer: frames arrive after a random delay, or are lost. State: frames, losses."""

    virtual = True

    def __init__(
        self, clock: ManualClock, delay_us: tuple[float, float] = (0.0, 0.0), loss: float = 0.0, seed: int = 1
    ):
        self.clock, self._delay_us, self._loss = clock, delay_us, loss
        self._chance, self.given = random.Random(seed), list[Frame]()
        self.peer, self.under_way, self.lost, self.sent, self.room = self, list[Received](), 0, 0, 10_000

    def send(self, frames: Rows) -> int:
        given = sent_frames(frames)[: self.room]
        self.given += given
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
    assert measure.queue_depth(near, far) == 10
    link.room = 1000
    assert measure.queue_depth(near, far) == 128


def test_frames_of_others_stop_the_last_measurements_too():
    near, far, link, _ = ends()
    link.peer.under_way.append(Received(50_000_000, Frame(0x181, bytes(8))))
    with pytest.raises(RunError, match="0x181"):
        measure.loss_at_rate(near, far, measure.frames_of([]), measure.frames_of([]), 500.0, 1, QUIET)
    link.peer.under_way.append(Received(near.clock.now(), Frame(0x182, bytes(8))))
    with pytest.raises(RunError, match="0x182"):
        measure.queue_depth(near, far)


def test_bus_without_an_answer_is_left_after_some_frames():
    near, far, link, _ = ends(loss=1.0)
    assert len(measure.latencies_us(near, far, BitTiming(1_000_000, 5_000_000), QUIET)) == 0
    assert link.sent <= 100


def test_interface_is_up_after_an_interruption_while_it_is_down(monkeypatch):
    calls = list[bool]()

    def set_up(_: int, *, up: bool) -> None:
        calls.append(up)
        if not up:
            raise KeyboardInterrupt

    near, far, *_ = ends()
    monkeypatch.setattr(netlink, "administers", lambda: True)
    monkeypatch.setattr(netlink, "set_up", set_up)
    with pytest.raises(KeyboardInterrupt):
        measure.recovery_ms(near, far, "lo")
    assert calls == [False, True]


@pytest.mark.parametrize("bitrate", [1_000_000, 500_000, 250_000, 125_000])
def test_network_interface_is_measured_at_a_rate_that_its_bit_rate_carries(monkeypatch, bitrate):
    monkeypatch.setattr(netlink, "get_link", lambda _: link(bitrate, fast=0))
    c = of_interface("can7")
    assert (c.bus.channel, c.bus.bitrate_bit_s, c.bus.layout) == ("can7", bitrate, "classic")
    assert c.loop.rate_Hz == 500.0 * bitrate / 1e6


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


FAMILIES: dict[str, tuple[Mapping[str, Any], Callable[[bool, int], bool]]] = {
    # protocol: changes of `desktop`, identifiers (flag, number) to which no drive listens, by the maker
    "legs": (FAMILY_CHANGES["legs, classic"], lambda wide, i: not wide and i not in LEGS_LISTEN),
    "cia402": (FAMILY_CHANGES["cia402, pdo"], lambda wide, i: not wide and 0x780 <= i not in (0x7E4, 0x7E5)),
    "mit": (FAMILY_CHANGES["mit, damiao DM4310"], lambda wide, i: not wide and 0x7F < i < 0x7FF),
    "robstride": (FAMILY_CHANGES["mit, robstride rs-02"], lambda wide, i: wide and i >> 24 == 31),
    "odrive": (FAMILY_CHANGES["odrive"], lambda wide, i: not wide and i >> 5 == 62),
    "moteus": (FAMILY_CHANGES["moteus"], lambda wide, i: wide and i >> 16 == 0x1F00),
    "dbc": (RMD, lambda wide, i: not wide and i not in range(0x141, 0x161)),
}
"""legs.dbc; CiA 301 and 305; DM4310 manual; RobStride manual, 4.1; ODrive: node in bits 5 to 10; moteus: prefix
in bits 16 to 28, can.prefix 0 as shipped; MyActuator: 0x140 + node."""


@pytest.mark.parametrize("family", FAMILIES)
def test_measured_frames_have_identifiers_to_which_no_drive_listens(tmp_path, monkeypatch, family):
    changes, unheard = FAMILIES[family]
    near, far, *links = ends()
    buses = iter((near, far))
    monkeypatch.setattr(Bus, "open", lambda *_, **__: next(buses))
    text = resources.files("configs").joinpath("desktop.yaml").read_text(encoding="utf-8")
    (tmp_path / "rmd.dbc").write_text((ROOT / "docs/examples/drives/rmd.dbc").read_text())
    c = loads(with_changes(text, changes), "my.yaml", tmp_path)
    _, summary = qualify(c, channel=None, receiver=None, duration_s=0.1, tell=QUIET)
    assert summary["lost"] == 0
    ours = [frame for each in links for frame in each.given]
    assert len(ours) > 1128
    assert [f for f in ours if not unheard(bool(f.flags & EXTENDED), f.id)] == []
    assert not any(any(f.data) for f in ours)


def on_vcan(folder: Path, interface: str = "socketcan") -> Configuration:
    text = resources.files("configs").joinpath("socketcan.yaml").read_text(encoding="utf-8")
    text = text.replace("channel: can0", "channel: hilX").replace("e: socketcan", f"e: {interface}")
    return loads(text, "my.yaml", folder)


def qualification(**changes: object) -> Qualification:
    fine: dict[str, object] = {
        "kind": "adapter", "version": VERSION, "date": "2026-01-01T00:00:00+00:00",
        "channel": "hilX", "received_on": "hilX", "adapter": "missing", "rate_Hz": 500.0,
        "layout": "classic", "bitrate_bit_s": 1_000_000, "data_bitrate_bit_s": 5_000_000, "latency_us": 100.0,
        "jitter_us": 10.0, "longest_us": 200.0, "sent": 10_000, "lost": 0, "refused": 0, "queue": 128,
        "can_fd": "not used", "time_stamps": ["software"], "error_frames": 0, "overflows": 0,
        "recovery_ms": None,
    }  # fmt: skip
    return Qualification.model_validate(fine | changes)


def written(path: Path, found: Qualification) -> None:
    write_section(path, found, "")


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
    ({"latency_us": WINDOW_US - WIRE_US - 1.0, "longest_us": WINDOW_US - WIRE_US - 0.5}, "", []),
    ({"longest_us": WINDOW_US - WIRE_US + 1.0}, "", ["late at times"]),
    ({"latency_us": WINDOW_US - WIRE_US + 1.0, "longest_us": 9000.0}, "too slow", []),
    ({"lost": 100}, "", ["loses 1.00%"]),
    ({"queue": 8}, "", ["accepts 8 frames"]),
    ({"queue": 9}, "", []),
    ({"refused": 1}, "", ["1 were refused"]),
    ({"can_fd": "failed"}, "", ["CAN FD"]),
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


def test_one_lost_frame_with_patient_limits_is_a_warning(tmp_path):
    """6 m^k underflows: no frame is lost often enough for 200 ticks in a row."""
    changes = {"limits": {"stale_fault_ticks": 200}}
    c = loads(with_changes(on_vcan(tmp_path).text, changes), "my.yaml", tmp_path)
    (text,) = judge(c, 0, qualification(lost=1)).warnings
    assert "STALE" not in text
    (text,) = judge(on_vcan(tmp_path), 0, qualification(lost=20_000)).warnings  # a damaged file: sent 10,000
    assert "100.00%" in text


@pytest.mark.usefixtures("unproven")
def test_check_budgets_with_the_qualification_next_to_the_configuration(tmp_path):
    c, file = on_vcan(tmp_path), tmp_path / "adapter-hilX.yaml"
    assert "bus adapter" not in inspect(c).codes
    written(file, qualification(longest_us=620.0))
    report = inspect(c)
    assert report.codes.count("bus adapter") == 1
    assert report.figures["bus"]["adapter_us"] == WIRE_US + 620.0
    written(file, qualification(latency_us=620.0, longest_us=620.0))
    with pytest.raises(ConfigurationError, match="too slow"):
        inspect(c)
    file.write_text("kind: adapter\nversion: 1\n")
    with pytest.raises(ConfigurationError, match="adapter-hilX"):
        inspect(c)


@pytest.mark.usefixtures("unproven")
def test_check_warns_of_another_adapter_or_setting(tmp_path):
    written(tmp_path / "adapter-hilX.yaml", qualification(adapter="gs_usb", rate_Hz=100.0))
    (text,) = [w for w in inspect(on_vcan(tmp_path)).warnings if "hilX" in w]
    assert "adapter is missing, was gs_usb" in text
    assert "loop.rate_Hz is 500, was 100" in text


def test_run_warns_once_of_another_adapter(tmp_path):
    (tmp_path / "my.yaml").write_text(on_vcan(tmp_path).text)
    for adapter, warnings in (("gs_usb", 1), ("missing", 0)):
        written(tmp_path / "adapter-hilX.yaml", qualification(adapter=adapter))
        done = CliRunner().invoke(main, ["run", str(tmp_path / "my.yaml"), "--arm"])
        assert done.exit_code == 2
        assert done.output.count("is not as qualified") == warnings


def test_drive_with_an_identifier_of_the_measurement_is_refused(tmp_path):
    drives = {"protocol": "odrive", "node_ids": [1, 2, 3, 4, 5, 62], "transmission": {"lead_m": 0.02}}
    changes = {"drives": {**drives, "watchdog_ms": 40}, "loop": {"rate_Hz": 125}}
    c = loads(with_changes(on_vcan(tmp_path).text, changes), "my.yaml", tmp_path)
    with pytest.raises(ConfigurationError, match="0x7C"):
        qualify(c, channel=None, receiver=None, duration_s=0.01, tell=QUIET)


def test_frame_that_clears_a_fault_counts_as_an_identifier_of_its_drive(tmp_path):
    text = resources.files("configs").joinpath("desktop.yaml").read_text(encoding="utf-8")
    (tmp_path / "rmd.dbc").write_text((ROOT / "docs/examples/drives/rmd.dbc").read_text())
    options = {"clear": "741#8800000000000000", "dbc_node": 1}
    changes = {"drives": {"node_ids": [*range(129, 135)], "options": options}}
    c = loads(with_changes(with_changes(text, RMD), changes), "my.yaml", tmp_path)
    with pytest.raises(ConfigurationError, match="0x7C1"):
        qualify(c, channel=None, receiver=None, duration_s=0.01, tell=QUIET)


def test_file_of_another_kind_is_not_replaced(tmp_path):
    file = tmp_path / "adapter-hilX.yaml"
    file.write_text("my notes")
    with pytest.raises(LogError, match="not overwritten"):
        qualify(on_vcan(tmp_path), channel=None, receiver=None, duration_s=0.01, tell=QUIET)
    assert file.read_text() == "my notes"


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
