"""The codec of a configuration with `drives.protocol: mit`."""

from drivers.config import BusSettings, DriveSettings
from drivers.mit.family import MitFamily
from drivers.mit.fields import VARIANTS, Ranges
from drivers.motor_settings import Options, refuse_layout, refuse_torque, required

_HOSTS = {"mini_cheetah": 0, "cubemars": 0, "damiao": 16, "robstride": 253}
"""Identifier of the replies; Damiao: what is added to a drive's own number; RobStride: the controller's."""
_FIELDS = {"position_rad": "position", "velocity_rad_s": "velocity", "torque_N_m": "torque"}


def mit(bus: BusSettings, drives: DriveSettings) -> MitFamily:
    """Return the variant's codec. Raises ConfigurationError for settings that it does not have."""
    refuse_layout(bus, "mit", "classic")
    transmission = required(drives.transmission, "mit")
    options = Options(drives.options, "mit", ("variant", "model", "host_id", *_FIELDS))
    variant = options.choice("variant", tuple(VARIANTS))
    models = VARIANTS[variant].models
    ranges: Ranges = models[options.choice("model", tuple(models))]
    given = {field: options.positive(key, getattr(ranges, field)) for key, field in _FIELDS.items()}
    ranges = ranges._replace(**given)
    host = options.whole("host_id", _HOSTS[variant])
    protocol: MitFamily
    if variant == "robstride":
        from drivers.mit.robstride import RobStrideProtocol  # noqa: PLC0415 - compiled code

        protocol = RobStrideProtocol(ranges, drives.node_ids, host, transmission, bus.legs)
    else:
        from drivers.mit.protocol import MitProtocol  # noqa: PLC0415 - compiled code

        protocol = MitProtocol(variant, ranges, drives.node_ids, host, transmission, bus.legs)
    refuse_torque(transmission, drives.force_limit_N, protocol.torque_limit, f"mit, variant {variant},")
    return protocol
