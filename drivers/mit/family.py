"""What all drives have in common that took MIT framing over: numbers are codes over ranges."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from drivers.config import BusSettings, DriveSettings
from drivers.mit.fields import TURN, VARIANTS, Ranges
from drivers.motor_settings import Options, refuse_torque
from drivers.motors import MotorProtocol
from drivers.protocol import Frame, Resolution, Traits
from drivers.signals import LEGS

_HOSTS = {"mini_cheetah": 0, "cubemars": 0, "damiao": 16, "robstride": 253}
"""Identifier of the replies; Damiao: what is added to a drive's own number; RobStride: the controller's."""
_FIELDS = {"position_rad": "position", "velocity_rad_s": "velocity", "torque_N_m": "torque"}


class MitFamily(MotorProtocol):
    """The tables of six drives with the same ranges."""

    def __init__(self, bus: BusSettings, drives: DriveSettings, torque_field: tuple[int, int]) -> None:
        """Take the sections, and first byte and bits of a command's torque.

        Raises ConfigurationError for settings that the variant does not have.
        """
        options = Options(bus, drives, "mit", "classic", ("variant", "model", "host_id", *_FIELDS))
        self.variant = options.choice("variant", tuple(VARIANTS))
        models = VARIANTS[self.variant].models
        ranges: Ranges = models[options.choice("model", tuple(models))]
        given = {field: options.positive(key, getattr(ranges, field)) for key, field in _FIELDS.items()}
        self.ranges = ranges = ranges._replace(**given)
        self.host = options.whole("host_id", _HOSTS[self.variant])
        super().__init__(options.transmission, drives.node_ids, (*torque_field, ranges.torque), bus.legs)
        for name in ("position", "velocity", "torque"):
            self.tables[name] = getattr(ranges, name)

    def traits_of(self, feedbacks: Iterable[Frame], **own: Any) -> Traits:
        """Return the traits; steps of position, velocity and torque are truncated, at either end."""
        r, (_, bits, _), t = self.ranges, self.torque_field, self.transmission
        fields = (r.position, 16), (r.velocity, bits), (r.torque, bits)
        position, velocity, torque = (2.0 * end / ((1 << n) - 1) for end, n in fields)
        length, rate = (t.rate(np.full(LEGS, step / TURN)) for step in (position, velocity))
        return super().traits_of(
            feedbacks,
            resolution=Resolution.of(length, rate, t.N_per_Nm * torque),
            reported_lengths=t.lengths_within(r.position / TURN),
            shares_identifiers=True,
            command_delay_ticks=1,
            **own,
        )

    def refuse_force(self, force_N: float) -> None:
        """Raise ConfigurationError if the rated force needs more torque than a command carries."""
        refuse_torque(self.transmission, force_N, self.torque_limit, f"mit, variant {self.variant},")
