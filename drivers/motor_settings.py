"""What the rows of motor protocols check: options, frame layout, transmission, torque."""

from collections.abc import Sequence
from math import inf, isfinite

import numpy as np

from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError
from drivers.transmission import Transmission


class Options:
    """The options of a protocol, and `transmission`."""

    def __init__(
        self, bus: BusSettings, drives: DriveSettings, protocol: str, layout: str, known: Sequence[str]
    ) -> None:
        """Take the sections, and the frame layout and the options that the protocol has.

        Raises ConfigurationError for another layout, without a transmission, for unknown options.
        """
        if bus.layout != layout:
            raise ConfigurationError(f"bus.layout: allowed with {protocol}: {layout}, given: {bus.layout}")
        if drives.transmission is None:
            raise ConfigurationError(
                f"drives.transmission: protocol {protocol} speaks of motors; state lead_m or "
                "pulley_radius_m, gear_ratio, sign and offset_m"
            )
        self.transmission = Transmission.of(drives.transmission)
        self._given, self._protocol = drives.options, protocol
        unknown = [key for key in self._given if key not in known]
        if unknown:
            raise ConfigurationError(
                f"drives.options: protocol {protocol} has {', '.join(known) or 'none'}, "
                f"given: {', '.join(unknown)}"
            )

    def choice(self, key: str, allowed: tuple[str, ...], default: str | None = None) -> str:
        """Return one of some words; the only one where nothing is given, or a default."""
        value = self._given.get(key, allowed[0] if len(allowed) == 1 else default)
        if value not in allowed:
            raise self._wrong(key, f"one of {', '.join(allowed)}")
        return str(value)

    def flag(self, key: str, *, default: bool) -> bool:
        """Return true or false."""
        value = self._given.get(key, default)
        if not isinstance(value, bool):
            raise self._wrong(key, "true, false")
        return value

    def positive(self, key: str, default: float) -> float:
        """Return a number above 0."""
        value = self._given.get(key, default)
        if isinstance(value, (bool, str)) or not value > 0.0:
            raise self._wrong(key, "a number greater than 0")
        return float(value)

    def within(self, key: str, least: float, most: float, what: str) -> float:
        """Return a number of a range, which has no default."""
        value = self._given.get(key)
        if isinstance(value, bool | str | None) or not least <= value <= most:
            raise self._wrong(key, f"{least:.12g} to {most:.12g}, {what}")
        return float(value)

    def whole(self, key: str, default: int, least: float = -inf, most: float = inf) -> int:
        """Return a whole number of a range."""
        value = self._given.get(key, default)
        if type(value) is not int or not least <= value <= most:
            raise self._wrong(key, "a whole number" + (f" of {least} to {most}" if isfinite(most) else ""))
        return value

    def _wrong(self, key: str, allowed: str) -> ConfigurationError:
        given = self._given.get(key, "nothing")
        return ConfigurationError(
            f"drives.options: {key} of protocol {self._protocol}: allowed: {allowed}, given: {given}"
        )


def refuse_torque(transmission: Transmission, force_N: float, torque_Nm: float, protocol: str) -> None:
    """Raise ConfigurationError if the rated force needs more torque than the family's field carries."""
    needed = np.abs(force_N / transmission.N_per_Nm / transmission.driving)
    leg = int(needed.argmax())
    if needed[leg] > torque_Nm:
        per, of = abs(transmission.N_per_Nm[leg]), f" of leg {leg}" if np.ptp(needed) > 0.0 else ""
        raise ConfigurationError(
            f"drives.force_limit_N: {force_N:g} N need {needed[leg]:.4g} N m of the motor{of} "
            f"({per:.4g} N a N m without losses), {protocol} carries up to {torque_Nm:g} N m: lower it, or "
            "change gear_ratio or lead_m"
        )


def unwatched(family: str) -> str:
    """Return the danger of drives whose watchdog nobody sets."""
    return (
        f"drives.watchdog_ms: {family} has no watchdog that is set from here; set the drive's own with its "
        "maker's tool if it has one, else it keeps its last torque for ever when the controller stops"
    )
