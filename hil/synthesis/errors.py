"""The refusal of the synthesis."""

from __future__ import annotations

from drivers.errors import ModelError


class SynthesisError(ModelError):
    """A design that no controller fulfils, or a problem that is not well posed."""
