"""Configuration sections `bus` and `drives`."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, field_validator, model_validator

from drivers.bus_address import BusAddress
from drivers.errors import ConfigurationError
from drivers.registry import registered
from drivers.section import PerLeg, Section
from drivers.signals import LEGS

Name = Annotated[
    str,
    BeforeValidator(
        lambda given: str(given) if type(given) is int else given, json_schema_input_type=str | int
    ),
]
"""Text, which YAML reads as a number where it is one: `channel: 0`."""
UDP = "udp"
"""Interface of a bus that carries the datagrams of motion capture, and nothing else."""
POSE_ID = 0x100
"""Identifier of such a datagram as a frame; its CRC counts it."""
DATAGRAM_BYTES = 64
MAX_BUSES = LEGS + 2
"""Each leg is on one bus; sensors may have buses of their own."""


class ChannelSettings(Section):
    """One bus of several (list `bus.channels`). Omitted keys take the values of the section `bus`."""

    channel: Name
    """Channel of the interface, different for each bus."""
    legs: Annotated[list[Annotated[int, Field(ge=0, lt=LEGS)]], Field(max_length=LEGS)] = []
    """Legs whose drives are on this bus, counted from 0; none on a bus of sensors."""
    layout: Literal["classic", "fd"] | None = None
    """Frames of a bus without legs; buses with legs have that of `bus.layout`."""
    interface: str | None = None
    """python-can interface: localcan, socketcan, udp_multicast, ..."""
    bitrate_bit_s: Annotated[int, Field(gt=0)] | None = None
    """Arbitration bit rate."""
    data_bitrate_bit_s: Annotated[int, Field(gt=0)] | None = None
    """Data-phase bit rate of CAN FD."""
    max_load_percent: Annotated[float, Field(gt=0, le=100)] | None = None
    """Largest bus load: a configuration whose cyclic frames take more of the period is refused."""
    options: dict[str, str | int | float | bool] | None = None
    """Keyword arguments for the python-can interface, besides channel and bit rates."""


def refuse_twice(what: str, given: Sequence[str | int]) -> None:
    """Raise ValueError for values that occur twice."""
    twice = sorted({each for each in given if given.count(each) > 1}, key=str)
    if twice:
        raise ValueError(f"{what}, allowed: each once, given twice: {', '.join(map(str, twice))}")


class BusSettings(Section):
    """The CAN bus and its frame layout; with several buses, the values that they share."""

    interface: str = BusAddress().interface
    """python-can interface: localcan, socketcan, udp_multicast, ..."""
    channel: Name = BusAddress().channel
    """Channel of that interface (vcan0, can0, a localcan name, a multicast group)."""
    layout: Literal["classic", "fd", "ideal"] = "fd"
    """Frame layout; `ideal` takes no bus time and is for theory only."""
    bitrate_bit_s: Annotated[int, Field(gt=0)] = 1_000_000
    """Arbitration bit rate."""
    data_bitrate_bit_s: Annotated[int, Field(gt=0)] = 5_000_000
    """Data-phase bit rate of CAN FD."""
    max_load_percent: Annotated[float, Field(gt=0, le=100)] = 70.0
    """Largest bus load: a configuration whose cyclic frames take more of the period is refused."""
    options: dict[str, str | int | float | bool] = {}
    """Keyword arguments for the python-can interface, besides channel and bit rates."""
    channels: Annotated[list[ChannelSettings], Field(max_length=MAX_BUSES)] = []
    """Several buses, with legs or sensors; then `channel` is that of the first bus and is left out."""

    @model_validator(mode="before")
    @classmethod
    def _first_of_several(cls, given: Any) -> Any:
        """Set `bus.channel` to that of the first of several buses, which is where tools look for the run."""
        several = given.get("channels") if isinstance(given, dict) else None
        channels = several if isinstance(several, list) else []
        first = channels[0] if channels else None
        name = first.get("channel") if isinstance(first, dict) else getattr(first, "channel", None)
        if name is None:
            return given
        if given.get("channel", name) != name:
            raise ValueError(
                f"both channel and channels, allowed: one of them, given: channel {given['channel']} and "
                f"{len(channels)} channels"
            )
        return {**given, "channel": name}

    @model_validator(mode="after")
    def _each_leg_once(self) -> "BusSettings":
        if not self.channels:
            return self
        names = [each.channel for each in self.channels]
        legs = [leg for each in self.channels for leg in each.legs]
        refuse_twice("channels have the same name", names)
        for each in self.channels:
            if each.legs and each.layout not in (None, self.layout):
                raise ValueError(
                    f"channel {each.channel} has legs and a layout of its own, allowed: that of bus.layout, "
                    f"{self.layout}, given: {each.layout}"
                )
        refuse_twice("legs are on two buses", legs)
        missing = [str(leg) for leg in range(LEGS) if leg not in legs]
        if missing:
            raise ValueError(
                f"legs are on no bus, allowed: each of 0 to {LEGS - 1} once, missing: {', '.join(missing)}"
            )
        return self

    @property
    def buses(self) -> "tuple[BusSettings, ...]":
        """Settings of each bus: address, bit rates and load limit with omitted keys filled in."""
        shared = {name: getattr(self, name) for name in BusSettings.model_fields if name != "channels"}
        if not self.channels:
            return (self,)
        own = [each.model_dump(exclude={"legs"}, exclude_none=True) for each in self.channels]
        whole = [shared | each for each in own]
        fd = {"layout": "fd"}  # 64 bytes in one frame
        return tuple(BusSettings(**each | (fd if each["interface"] == UDP else {})) for each in whole)

    @property
    def legs(self) -> tuple[tuple[int, ...], ...]:
        """Legs of each bus, in ascending order."""
        if not self.channels:
            return (tuple(range(LEGS)),)
        return tuple(tuple(sorted(each.legs)) for each in self.channels)

    def index_of(self, channel: str | None) -> int:
        """Index of the bus with a channel; 0 for a node that names no channel.

        Raises ConfigurationError for an unknown channel.
        """
        names = [each.channel for each in self.buses]
        if channel is not None and channel not in names:
            raise ConfigurationError(f"unknown bus, allowed: {', '.join(names)}, given: {channel}")
        return 0 if channel is None else names.index(channel)


Above0 = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(gt=0, le=1)]
Side = Literal[1, -1]
PerLegAbove0 = Above0 | Annotated[list[Above0], Field(min_length=6, max_length=6)]
PerLegShare = Share | Annotated[list[Share], Field(min_length=6, max_length=6)]
PerLegSide = Side | Annotated[list[Side], Field(min_length=6, max_length=6)]


class TransmissionSettings(Section):
    """Transmission between each motor and its leg; each value is one for all legs, or six in leg order.

    The motor is the shaft whose position and torque the drive reports; for a gear motor with an output
    encoder that is its output shaft.
    """

    lead_m: PerLegAbove0 | None = None
    """Lead of the screw: leg length per turn. Either this or `pulley_radius_m`."""
    pulley_radius_m: PerLegAbove0 | None = None
    """Pitch radius of the pulley or pinion that moves the leg."""
    gear_ratio: PerLegAbove0 = 1.0
    """Turns of the motor per turn of the screw or pulley."""
    sign: PerLegSide = 1
    """1 if positive turns of the motor extend the leg, -1 if they shorten it."""
    efficiency: PerLegShare = 1.0
    """Share, 0 to 1, of the motor's work that reaches the leg."""
    back_driving_efficiency: PerLegShare = 1.0
    """Share of the leg's work that reaches the motor. A self-locking screw has none: no force on its leg
    moves it, so a force law cannot control it."""
    full_loss_m_s: Above0 = 1e-3
    """Leg rate above which the losses act in full; below it they fade to none at rest."""
    offset_m: PerLeg = 0.0
    """Leg length, joint centre to joint centre, at which the drive reads position zero."""
    counts_per_turn: PerLegAbove0 = 65536.0
    """Encoder counts per turn of the motor, for drives that report counts."""

    @model_validator(mode="after")
    def _screw_or_pulley(self) -> "TransmissionSettings":
        given = [name for name in ("lead_m", "pulley_radius_m") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(
                "a screw or a pulley moves the leg, allowed: one of lead_m, pulley_radius_m, given: "
                f"{' and '.join(given) or 'neither'}"
            )
        return self


class HomingSettings(Section):
    """Homing of drives whose absolute encoder loses count of whole motor turns at power-off."""

    file: str
    """YAML file with the lengths at which the legs were parked, relative to the configuration file. The run
    writes it when it ends at rest. `hil homing` shows it, and writes it if the lengths are known from
    elsewhere."""
    limit_m: Above0
    """A leg found farther than this from its parked length keeps the run from being armed. Less than a
    quarter of the length that the drive forgets."""
    forgotten_turns: PerLegAbove0 = 1.0
    """Turns of the motor of which the drive forgets a whole multiple: 1 if the encoder is on the shaft that
    `transmission` describes, 1 / 9 if it is in front of a gear of 9 : 1."""


def _name_protocols(schema: dict[str, Any]) -> None:
    schema["enum"] = list(registered("hil.protocols"))


class DriveSettings(Section):
    """The six drives: protocol, node numbers, force limit, watchdog and transmission."""

    protocol: Annotated[str, Field(json_schema_extra=_name_protocols)] = "legs"
    """Drive family: an entry point of the group `hil.protocols`."""
    node_ids: Annotated[list[int], Field(min_length=6, max_length=6)] = [1, 2, 3, 4, 5, 6]
    """Node number of each leg's drive, in leg order, in the range of the protocol: 1 to 127 with `legs`."""
    options: dict[str, str | int | float | bool] = {}
    """Options of the drive protocol; `legs` has none."""
    transmission: TransmissionSettings | None = None
    """Transmission of drives that report motor values; `legs` reports leg values and has none."""
    homing: HomingSettings | None = None
    """For drives that lose count of motor turns at power-off; left out for absolute multi-turn encoders."""
    watchdog_ms: Annotated[float, Field(gt=0)] = 10.0
    """Watchdog: a drive without a command for this long reacts by itself, see `reactions.silence`. At least 3
    periods."""
    brake_after_ms: Annotated[float, Field(gt=0)] = 1000.0
    """A drive that damps or holds by itself closes its brake this long after its fault. No frame of `legs`
    carries it: a real drive has it in its own set-up."""
    heartbeat_ms: Annotated[float, Field(ge=1, le=60_000)] = 100.0
    """Period of each drive's status message. The bus budget counts those that occur in every tick."""
    force_limit_N: Annotated[float, Field(gt=0)] = 60_000.0
    """Rated force: the controller never commands more, and the drive saturates there. Short force fields of
    `legs` count in 1/16000 of it, and a drive of another rating is refused."""

    @field_validator("protocol")
    @classmethod
    def _known(cls, name: str) -> str:
        known = registered("hil.protocols")
        if name not in known:
            raise ValueError(f"unknown value, allowed: {', '.join(known)}, given: {name}")
        return name

    @field_validator("node_ids")
    @classmethod
    def _each_once(cls, ids: list[int]) -> list[int]:
        refuse_twice("two legs have the same node number", ids)
        return ids
