"""Qualification of a CAN adapter: its file, its share of a tick's budget, its comparison at start."""

from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from drivers.can.adapter import identity
from drivers.can.bus_time import BitTiming, frame_time_ns
from drivers.config import BusSettings
from drivers.errors import ConfigurationError
from drivers.frame_array import sent_frames
from drivers.section import Section
from drivers.signals import LEGS
from hil.app.compose import build_protocol, drive_setup
from hil.app.configuration.bus_budget import bus_budgets
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.section_file import read_section
from hil.app.configuration.text_file import shipped_file

VERSION = 1
SELDOM_s = 1000 * 3600.0
"""A fault by lost frames that comes less often than this is not worth a warning."""
_Some = Annotated[int, Field(ge=0)]
_Time = Annotated[float, Field(ge=0)]


class Qualification(Section):
    """Figures of one CAN interface under the frames and the rate of one configuration."""

    kind: Literal["adapter"]
    version: int
    date: str
    channel: str
    received_on: str
    """Channel on which the frames were received: another interface of the bus, or the same one."""
    adapter: str
    rate_Hz: float
    layout: str
    bitrate_bit_s: int
    data_bitrate_bit_s: int
    latency_us: _Time
    """Median time from the call that sends a frame to its reception, without bus time."""
    jitter_us: _Time
    """Half of the range that 98 % of the latencies lie in."""
    longest_us: _Time
    sent: _Some
    """Frames that the interface accepted at the rate of the loop; it refused others."""
    lost: _Some
    refused: _Some
    queue: _Some
    """Frames that the interface accepts at once, at most those tried."""
    can_fd: Literal["passed", "failed", "not used"]
    """Result of one CAN FD frame of 64 bytes with bit-rate switch."""
    time_stamps: list[str]
    """Time stamps of received frames by the kernel: software, hardware."""
    error_frames: _Some
    overflows: _Some
    recovery_ms: _Time | None
    """Time from taking the interface down to the first frame after it is up; null: not measured."""

    @property
    def loss(self) -> float:
        """Share of lost frames."""
        return min(self.lost / max(self.sent, 1), 1.0)


def qualification_path(c: Configuration, bus: BusSettings) -> Path:
    """Qualification file of a bus, next to the configuration; of a shipped one in the working folder."""
    name = "".join(each if each.isalnum() else "_" for each in bus.channel)
    folder = Path() if c.folder == shipped_file("").parent else c.folder
    return folder / f"adapter-{name}.yaml"


def qualifications(c: Configuration) -> list[Qualification | None]:
    """Qualification of each bus, None without a file. Raises ConfigurationError for a damaged file."""
    paths = [qualification_path(c, bus) for bus in c.bus.buses]
    found = [read_section(path, Qualification)[0] if path.exists() else None for path in paths]
    for path, file in zip(paths, found, strict=True):
        if file is not None and file.version != VERSION:
            raise ConfigurationError(f"{path}: version {file.version}, allowed: {VERSION}: run `hil adapter`")
    return found


def differences(c: Configuration) -> list[str]:
    """One sentence for each bus whose adapter or settings are not those of its qualification."""
    found = []
    for bus, file in zip(c.bus.buses, qualifications(c), strict=True):
        if file is None:
            continue
        rows = [("adapter", file.adapter, identity(bus))]
        keys = ("layout", "bitrate_bit_s", "data_bitrate_bit_s")
        rows += [(f"bus.{key}", getattr(file, key), getattr(bus, key)) for key in keys]
        rows += [("loop.rate_Hz", f"{file.rate_Hz:g}", f"{max(c.loop.rate_Hz, file.rate_Hz):g}")]
        if changed := [f"{what} is {now}, was {was}" for what, was, now in rows if now != was]:
            found.append(
                f"{bus.channel} is not as qualified on {file.date}: {'; '.join(changed)}; "
                f"repeat `hil adapter {c.source}`"
            )
    return found


class Judgement(NamedTuple):
    """What speaks against an adapter, one sentence each."""

    answer_us: float
    """Longest time from SYNC to the last feedback: bus time and the adapter's longest latency."""
    refused: str
    """Reason why no tick can work; empty if none."""
    warnings: list[str]


def answered_ns(c: Configuration) -> list[int]:
    """Bus time, ns, of SYNC or polls and the feedback frames, one value for each bus."""
    protocol = build_protocol(c)
    traits = protocol.traits
    opening = sent_frames(protocol.controller_end(drive_setup(c, c.loop.rate_Hz)).begin(0))
    opens = {frame.id for frame in opening}
    counted = [frame for frame in traits.sent if frame.id in opens] + [*traits.feedbacks]
    if traits.unasked_s > 0.0:  # a frame that a drive sends by a timer may delay the last answer
        asked = {(frame.id, frame.flags) for frame in opening}
        answers = {frame.bus: frame for frame in counted if (frame.id, frame.flags) not in asked}
        counted += answers.values()
    return [
        sum(frame_time_ns(len(f.data), f.flags, BitTiming.of(each)) for f in counted if f.bus == index)
        for index, each in enumerate(c.bus.buses)
    ]


def stale_every_s(c: Configuration, loss: float) -> float:
    """Mean time, s, between faults STALE by lost frames alone; loss: share of lost frames.

    A leg misses a tick where its SYNC (or poll) or its feedback is lost, m = 1 - (1 - loss)^2. The fault
    needs stale_fault_ticks = k such ticks in a row: at most 6 m^k a tick.
    """
    faults_per_s = LEGS * (1.0 - (1.0 - loss) ** 2) ** c.limits.stale_fault_ticks * c.loop.rate_Hz
    return 1.0 / faults_per_s if faults_per_s else float("inf")


def judge(c: Configuration, index: int, q: Qualification) -> Judgement:
    """Adapter of bus `index` under the frames of a tick, the feedback window and the limits.

    One exchange passes the adapter twice: SYNC or poll out, feedback in. So does the measured frame, from
    the call that sends it to its reception; hence one latency is added to the bus time.
    """
    name, wire_us, window_us = q.channel, 1e-3 * answered_ns(c)[index], 1e6 * c.loop.window_s(c.loop.rate_Hz)
    frames = bus_budgets(c.bus, c.drives, c.sensors, c.loop.rate_Hz, c.folder)[index].frames.total()
    usual_us, answer_us, refused, found = wire_us + q.latency_us, wire_us + q.longest_us, "", []
    total = (
        f"from SYNC to the last feedback {wire_us:.0f} us of bus time and {{:.0f}} us of latency are "
        f"{{:.0f}} us {{}}, and the window has {window_us:.0f} us; lower loop.rate_Hz, or "
    ).format
    if usual_us > window_us:
        text = total(q.latency_us, usual_us, "in half of all ticks")
        refused = f"{name} is too slow: {text}measure another adapter"
    elif answer_us > window_us:
        text = total(q.longest_us, answer_us, "at worst")
        found.append(f"{name} is late at times: {text}lengthen loop.feedback_window_us")
    if q.lost:
        every_s, ticks = stale_every_s(c, q.loss), c.limits.stale_fault_ticks
        often = f", enough for a fault STALE about every {every_s / 60:.3g} min" if every_s < SELDOM_s else ""
        found.append(
            f"{name} loses {q.loss:.2%} of the frames{often} (limits.stale_fault_ticks {ticks}); CAN repeats "
            "damaged frames, so the adapter or its driver loses them: use another adapter, or several buses"
        )
    if q.refused or q.queue < frames:
        found.append(
            f"{name} accepts {q.queue} frames at once, and a tick has {frames}; {q.refused} were refused at "
            f"{q.rate_Hz:g} Hz: 'ip link set {name} txqueuelen {max(32, 2 * frames)}'"
        )
    if q.can_fd == "failed":
        found.append(
            f"{name} does not pass CAN FD with bit-rate switch: set dbitrate and 'fd on', see bus.layout"
        )
    return Judgement(answer_us, refused, found)
