"""Rules on a reference that the loop's rate decides."""

from collections.abc import Iterator

from hil.app.configuration.yaml_positions import Path
from hil.config.loop import LoopSettings
from hil.config.reference import MultisineReference, ReferenceSettings, SinusoidReference


def frequencies(reference: ReferenceSettings, loop: LoopSettings, _: object) -> Iterator[tuple[Path, str]]:
    """Refuse a frequency above half the rate: the legs would follow another one (Shannon, 1949)."""
    found: list[tuple[Path, float]] = []
    if isinstance(reference, SinusoidReference):
        found = [
            (("components", n, "frequency_Hz"), one.frequency_Hz)
            for n, one in enumerate(reference.components)
        ]
    elif isinstance(reference, MultisineReference):
        found = [(("axes", n, "band_Hz"), max(one.band_Hz)) for n, one in enumerate(reference.axes)]
    for path, highest_Hz in found:
        if highest_Hz > loop.rate_Hz / 2:
            message = (
                f"above half the rate, allowed: up to {loop.rate_Hz / 2:g} (loop.rate_Hz {loop.rate_Hz:g}), "
                f"given: {highest_Hz:g}"
            )
            yield ("reference", *path), message
