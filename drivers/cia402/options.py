"""The row of CiA 402 in `drivers.PROTOCOLS`: checks the sections `bus` and `drives`."""

from math import isfinite

from drivers.cia402.protocol import MAX_NODE, Cia402Protocol
from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError
from drivers.transmission import Transmission

_VELOCITY = ("pdo", "difference")
_ALLOWED = ("rated_torque_Nm", "velocity", "controller_node", "check_encoder", "eds")
_MOST_Nm = 4_294_967.0
"""What 0x6076 can say."""


def cia402(bus: BusSettings, drives: DriveSettings) -> Cia402Protocol:
    """Return the codec of a configuration.

    Raises ConfigurationError, with the key, for what such drives do not have or what they need and lack.
    """
    options = drives.options
    if bus.layout != "classic":
        raise ConfigurationError(
            f"bus.layout: allowed with cia402: classic, frames of up to 8 bytes, given: {bus.layout}"
        )
    for name in options:
        if name not in _ALLOWED:
            raise ConfigurationError(
                f"drives.options.{name}: unknown, allowed with cia402: {', '.join(_ALLOWED)}"
            )
    if drives.transmission is None:
        raise ConfigurationError(
            "drives.transmission: missing, cia402 drives speak of counts and torques: give lead_m or "
            "pulley_radius_m, gear_ratio, sign, offset_m and counts_per_turn"
        )
    rated = options.get("rated_torque_Nm")
    if isinstance(rated, bool | str | None) or not isfinite(rated) or not 1e-3 <= rated <= _MOST_Nm:
        raise ConfigurationError(
            "drives.options.rated_torque_Nm: the motors' rated torque, 0x6076, of which torques are "
            f"thousandths, allowed: 0.001 to {_MOST_Nm:.0f}, given: {rated}"
        )
    velocity = options.get("velocity", "pdo")
    if velocity not in _VELOCITY:
        raise ConfigurationError(
            f"drives.options.velocity: allowed: {', '.join(_VELOCITY)}, given: {velocity}"
        )
    node = options.get("controller_node", MAX_NODE)
    if type(node) is not int or not 1 <= node <= MAX_NODE:
        raise ConfigurationError(
            f"drives.options.controller_node: allowed: a whole number of 1 to {MAX_NODE}, given: {node}"
        )
    check = options.get("check_encoder", True)
    if not isinstance(check, bool):
        raise ConfigurationError(f"drives.options.check_encoder: allowed: true, false, given: {check}")
    return Cia402Protocol(
        drives.node_ids,
        Transmission.of(drives.transmission),
        float(rated),
        force_limit_N=drives.force_limit_N,
        heartbeat_ms=drives.heartbeat_ms,
        velocity=velocity == "pdo",
        controller_node=node,
        check_encoder=check,
    )
