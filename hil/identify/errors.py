"""What a log may lack."""

from __future__ import annotations

from drivers.errors import ModelError


class IdentificationError(ModelError):
    """The log does not hold what the estimate needs."""
