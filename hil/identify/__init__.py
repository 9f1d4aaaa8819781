"""What a log tells of the loop: how long a force takes, and what the linearised axes are like."""

from hil.identify.axis_fit import Fit, Uncertainty, fit_axes, uncertainty
from hil.identify.delay import Delay, Motion, force_delay
from hil.identify.errors import IdentificationError
from hil.identify.excite import axis_excitation
from hil.identify.linearised import AxisSignals, demanded_accelerations, state_of
from hil.identify.nominal import axis_response
from hil.identify.response import Response, estimate
from hil.identify.spectra import Spectra, periodic, segmented

__all__ = [
    "AxisSignals",
    "Delay",
    "Fit",
    "IdentificationError",
    "Motion",
    "Response",
    "Spectra",
    "Uncertainty",
    "axis_excitation",
    "axis_response",
    "demanded_accelerations",
    "estimate",
    "fit_axes",
    "force_delay",
    "periodic",
    "segmented",
    "state_of",
    "uncertainty",
]
