"""What the controller's end makes of arrays of frames: which answers are fresh, and for whom a frame is."""

from drivers.arrays import Rows
from drivers.compiled.compiler import INTEGER, direct, records
from drivers.compiled.pointed import address_of, call
from drivers.ends import Hearing
from drivers.frame_array import FRAME


def fresh_ids(hears: Hearing, frames: Rows, tick: int, since_ns: int) -> list[int]:
    """Return what is `awaited` of a tick and `fresh` among frames."""
    places = fresh_places(hears.fresh, hears.context, frames, tick, since_ns)
    return [each for k, each in enumerate(hears.wanted) if places >> k & 1]


@direct(INTEGER, INTEGER, records(FRAME), INTEGER, INTEGER)
def fresh_places(fresh: int, context: int, frames: Rows, tick: int, since_ns: int) -> int:
    """Return bit k for a frame that is `Hearing.fresh` and has place k in `wanted`, of all frames."""
    places = 0
    for k in range(len(frames)):
        place = call(fresh, (context, address_of(frames[k]), tick, since_ns))
        if place > 0:
            places |= 1 << (place - 1)
    return places


@direct(INTEGER, INTEGER, records(FRAME), INTEGER)
def legs_addressed(addressed: int, context: int, frames: Rows, k: int) -> int:
    """Return bit i where frame k is for leg i, by `Hearing.addressed`."""
    return int(call(addressed, (context, address_of(frames[k]))))
