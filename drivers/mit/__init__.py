"""MIT mini-cheetah framing, and the drives that adopted it, as one protocol with variants."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drivers.config import BusSettings, DriveSettings
    from drivers.mit.protocol import MitFamily


def mit(bus: BusSettings, drives: DriveSettings) -> MitFamily:
    """Codec of the variant of MIT framing that `drives.options` selects."""
    from drivers.mit.protocol import MitProtocol  # noqa: PLC0415 - compiled code
    from drivers.mit.robstride import RobStrideProtocol  # noqa: PLC0415

    kind = RobStrideProtocol if drives.options.get("variant") == "robstride" else MitProtocol
    return kind(bus, drives)
