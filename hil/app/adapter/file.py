"""Qualification file of a CAN adapter: what `hil adapter` measured, read by `hil check` and `hil run`."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from drivers.can.adapter import identity
from drivers.config import BusSettings
from drivers.errors import ConfigurationError
from drivers.section import Section
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.section_file import read_section, write_section
from hil.app.configuration.text_file import shipped_file

VERSION = 1
_REMARK = "measured by `hil adapter`; `hil check` budgets with it, `hil run` compares the adapter"
_Some = Annotated[int, Field(ge=0)]
_Time = Annotated[float, Field(ge=0)]


class Qualification(Section):
    """Figures of one CAN interface under the frames and the rate of one configuration."""

    kind: Literal["adapter"]
    version: int
    date: str
    """UTC."""
    interface: str
    channel: str
    receiver: str
    """Channel on which the frames were received: another interface of the bus, or the same one."""
    adapter: str
    """Driver and hardware of the interface."""
    kernel: str
    rate_Hz: float
    layout: str
    bitrate_bit_s: int
    data_bitrate_bit_s: int
    latency_us: _Time
    """Median time from the call that sends a frame to its reception, without bus time."""
    jitter_us: _Time
    """Half of the range that 98 % of the latencies lie in."""
    worst_us: _Time
    """Longest latency."""
    sent: _Some
    """Frames sent at the rate of the loop."""
    lost: _Some
    """Those of them that were not received."""
    unsent: _Some
    """Frames that the interface refused meanwhile."""
    queue: _Some
    """Frames that the interface accepts at once."""
    queue_filled: bool
    """False if it accepted all that were tried."""
    fd: Literal["passed", "failed", "not used"]
    """Result of one CAN FD frame of 64 bytes with bit-rate switch."""
    stamps: list[str]
    """Time stamps of received frames by the kernel: software, hardware."""
    error_frames: _Some
    overflows: _Some
    restart_ms: _Some | None
    """Delay of the kernel's own restart after bus-off; 0: none; null: no controller."""
    recovery_ms: _Time | None
    """Time from taking the interface down to the first frame after it is up; null: not measured."""

    @property
    def loss(self) -> float:
        """Share of lost frames."""
        return self.lost / self.sent if self.sent else 0.0


def qualification_path(c: Configuration, bus: BusSettings) -> Path:
    """Qualification file of a bus, next to the configuration; of a shipped one in the working folder."""
    name = "".join(each if each.isalnum() else "_" for each in bus.channel)
    folder = Path() if c.folder == shipped_file("").parent else c.folder
    return folder / f"adapter-{name}.yaml"


def write_qualification(path: Path, found: Qualification) -> None:
    """Write the file, replacing an earlier one. Raises ConfigurationError if it cannot be written."""
    write_section(path, found, _REMARK)


def qualifications(c: Configuration) -> list[Qualification | None]:
    """Qualification of each bus, None without a file. Raises ConfigurationError for a damaged file."""
    found: list[Qualification | None] = []
    for bus in c.bus.buses:
        path = qualification_path(c, bus)
        if not path.exists():
            found.append(None)
            continue
        file, _ = read_section(path, Qualification)
        if file.version != VERSION:
            raise ConfigurationError(f"{path}: version {file.version}, allowed: {VERSION}: run `hil adapter`")
        found.append(file)
    return found


def differences(c: Configuration) -> list[str]:
    """One sentence for each bus whose adapter or settings are not those of its qualification."""
    found = []
    for bus, file in zip(c.bus.buses, qualifications(c), strict=True):
        if file is None:
            continue
        rows = [
            ("adapter", file.adapter, identity(bus)),
            ("bus.layout", file.layout, bus.layout),
            ("bus.bitrate_bit_s", file.bitrate_bit_s, bus.bitrate_bit_s),
            ("bus.data_bitrate_bit_s", file.data_bitrate_bit_s, bus.data_bitrate_bit_s),
        ]
        changed = [f"{what} is {now}, was {was}" for what, was, now in rows if now != was]
        if c.loop.rate_Hz > file.rate_Hz:
            changed.append(f"loop.rate_Hz is {c.loop.rate_Hz:g}, was {file.rate_Hz:g}")
        if changed:
            found.append(
                f"{bus.channel} is not as qualified on {file.date}: {'; '.join(changed)}; "
                f"repeat `hil adapter {c.source}`"
            )
    return found
