"""Configuration sections `bus` and `drives`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator


class Section(BaseModel):
    """Base of all configuration sections: unknown keys refused, values frozen, NaN refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)


class BusSettings(Section):
    """The CAN bus and how the frames are laid out on it."""

    interface: str = "localcan"
    """python-can interface: localcan, socketcan, udp_multicast, ..."""
    channel: str = "hil0"
    """Channel of that interface (vcan0, can0, a localcan name, a multicast group)."""
    layout: Literal["classic", "fd", "ideal"] = "fd"
    """Frame layout of the own protocol; `ideal` takes no bus time and is for theory only."""
    bitrate_bit_s: Annotated[int, Field(gt=0)] = 1_000_000
    """Arbitration bit rate."""
    data_bitrate_bit_s: Annotated[int, Field(gt=0)] = 5_000_000
    """Data-phase bit rate of CAN FD."""
    max_load_percent: Annotated[float, Field(gt=0, le=100)] = 70.0
    """Refuse a configuration whose cyclic frames take more of the period than this."""
    options: dict[str, str | int | float | bool] = {}
    """Further keyword arguments for the python-can interface."""


class DriveSettings(Section):
    """The six drives."""

    protocol: Literal["legs"] = "legs"
    node_ids: Annotated[list[Annotated[int, Field(ge=1, le=127)]], Field(min_length=6, max_length=6)] = [
        1,
        2,
        3,
        4,
        5,
        6,
    ]
    """Node number of each leg's drive, leg order."""
    watchdog_ms: Annotated[float, Field(gt=0)] = 10.0
    """A drive that hears no command for this long reacts by itself. At least 3 periods."""
    reaction: Literal["brake", "damp", "hold", "zero"] = "brake"
    """What a drive does by itself when its watchdog expires in motion. An emergency stop always brakes."""
    heartbeat_ms: Annotated[float, Field(gt=0)] = 100.0
    """Period of each drive's status message."""
    force_limit_N: Annotated[float, Field(gt=0)] = 60_000.0
    """Rated force: the controller never asks for more and the drive clips there."""

    @field_validator("node_ids")
    @classmethod
    def _each_once(cls, ids: list[int]) -> list[int]:
        twice = sorted({n for n in ids if ids.count(n) > 1})
        if twice:
            numbers = ", ".join(map(str, twice))
            raise ValueError(
                f"two legs have the same node number, allowed: each once, given twice: {numbers}"
            )
        return ids
