"""Checks of the settings of single-motor protocols: options, frame layout, transmission, torque."""

from collections.abc import Sequence
from math import inf, isfinite
from typing import Any

import numpy as np

from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError
from drivers.transmission import Transmission


class Options:
    """Reads the keys of `drives.options` for one protocol, and its `transmission`."""

    def __init__(
        self, bus: BusSettings, drives: DriveSettings, protocol: str, layout: str, known: Sequence[str]
    ) -> None:
        """Read the sections; layout, known: frame layout and option keys of the protocol.

        Raises ConfigurationError for another layout, without a transmission, for unknown options.
        """
        if bus.layout != layout:
            raise ConfigurationError(f"bus.layout: allowed with {protocol}: {layout}, given: {bus.layout}")
        if drives.transmission is None:
            raise ConfigurationError(
                f"drives.transmission: protocol {protocol} reports motor values; set lead_m or "
                "pulley_radius_m, gear_ratio, sign and offset_m"
            )
        self.transmission = Transmission(drives.transmission)
        self._given, self._protocol = drives.options, protocol
        unknown = [key for key in self._given if key not in known]
        if unknown:
            raise ConfigurationError(
                f"drives.options: protocol {protocol} has {', '.join(known) or 'none'}, "
                f"given: {', '.join(unknown)}"
            )

    def choice(self, key: str, allowed: tuple[str, ...], default: str | None = None) -> str:
        """Value of an option that must be one of `allowed`; if omitted, the only one or the default."""
        value = self._given.get(key, allowed[0] if len(allowed) == 1 else default)
        return str(self._fitting(key, value, value in allowed, f"one of {', '.join(allowed)}"))

    def flag(self, key: str, *, default: bool) -> bool:
        """Boolean value of an option."""
        value = self._given.get(key, default)
        return bool(self._fitting(key, value, isinstance(value, bool), "true, false"))

    def positive(self, key: str, default: float) -> float:
        """Value of an option that must be a number above 0."""
        value = self._given.get(key, default)
        fits = not isinstance(value, bool | str) and value > 0.0
        return float(self._fitting(key, value, fits, "a number greater than 0"))

    def within(self, key: str, least: float, most: float, what: str) -> float:
        """Value of an option that must be a number in least..most; it has no default. what: its meaning."""
        value = self._given.get(key)
        fits = not isinstance(value, bool | str | None) and least <= value <= most
        return float(self._fitting(key, value, fits, f"{least:.12g} to {most:.12g}, {what}"))

    def whole(self, key: str, default: int, least: float = -inf, most: float = inf) -> int:
        """Value of an option that must be an integer in least..most."""
        value = self._given.get(key, default)
        within = f" of {least} to {most}" if isfinite(most) else ""
        fits = type(value) is int and least <= value <= most
        return int(self._fitting(key, value, fits, f"a whole number{within}"))

    def _fitting(self, key: str, value: Any, fits: bool, allowed: str) -> Any:
        if not fits:
            raise ConfigurationError(
                f"drives.options: {key} of protocol {self._protocol}: allowed: {allowed}, given: "
                f"{self._given.get(key, 'nothing')}"
            )
        return value


def refuse_torque(transmission: Transmission, force_N: float, torque_Nm: float, protocol: str) -> None:
    """Raise ConfigurationError if the rated force, N, needs more torque than the field's end, N m."""
    needed = np.abs(force_N / transmission.N_per_Nm / transmission.driving)
    leg = int(needed.argmax())
    if needed[leg] > torque_Nm:
        per, of = abs(transmission.N_per_Nm[leg]), f" of leg {leg}" if np.ptp(needed) > 0.0 else ""
        raise ConfigurationError(
            f"drives.force_limit_N: {force_N:g} N need {needed[leg]:.4g} N m of the motor{of} "
            f"({per:.4g} N per N m without losses), but {protocol} carries up to {torque_Nm:g} N m: lower "
            "force_limit_N, or change gear_ratio or lead_m"
        )


def unwatched(family: str) -> str:
    """Warning text for drives without a watchdog that this program can set."""
    return (
        f"drives.watchdog_ms: {family} has no watchdog that this program sets; set the drive's own with its "
        "maker's tool if it has one, else it keeps its last torque without end when the controller stops"
    )
