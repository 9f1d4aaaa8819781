"""Times at which the drives sampled their encoders, as the controller knows them, and fresh answers.

A drive samples when its SYNC or poll has ended on the bus. The clock at wake-up does not show that instant: a
stall before the write delays the frame. A stall after the write delays the reading of the clock instead. Then
the answer limits the instant: it cannot arrive earlier than its own time on the wire after the SYNC. Damaged
answers, and answers to an older SYNC, show nothing.
"""

from collections.abc import Sequence

from drivers.arrays import Rows
from drivers.compiled.compiler import INTEGER, kernel, records
from drivers.compiled.pointed import address_of, call
from drivers.family import Family
from drivers.frame_array import FRAME, received_frames, sent_frames
from drivers.signals import LEGS


def fresh_ids(protocol: Family, frames: Rows, tick: int, since_ns: int) -> list[int]:
    """Identifiers, as in `Family.wanted`, of those frames that are valid feedback of this tick."""
    places = fresh_places(protocol.fresh_by.address, protocol.context, frames, tick, since_ns)
    return [each for k, each in enumerate(protocol.wanted) if places >> k & 1]


@kernel(INTEGER, INTEGER, records(FRAME), INTEGER, INTEGER)
def fresh_places(fresh: int, context: int, frames: Rows, tick: int, since_ns: int) -> int:
    """Bit k: valid feedback k of `Family.wanted` in this tick is among the frames; fresh: its function."""
    places = 0
    for k in range(len(frames)):
        place = call(fresh, (context, address_of(frames[k]), tick, since_ns))
        if place > 0:
            places |= 1 << (place - 1)
    return places


@kernel(INTEGER, INTEGER, records(FRAME), INTEGER)
def legs_addressed(addressed: int, context: int, frames: Rows, k: int) -> int:
    """Legs that frame k addresses, bit i: leg i; addressed: address of `Family.addressed_by`."""
    return int(call(addressed, (context, address_of(frames[k]))))


PROMPT_NS = 100_000
"""A send that took less time than this, and less than an answer takes, is not checked against its answers."""


def latch_ns(protocol: Family, opening: Rows, sent_ns: Sequence[int | None], woke_ns: int) -> tuple[int, ...]:
    """Time from the wake-up until each leg's SYNC or poll was sent, ns; 0 for a leg without one.

    sent_ns: send times of the first frames of `opening`; the bus did not accept the others, and no frame with
    None.
    """
    delays = [0] * LEGS
    for k, t_ns in zip(range(len(opening)), sent_ns, strict=False):
        if t_ns is not None:
            legs = legs_addressed(protocol.addressed_by.address, protocol.context, opening, k)
            for leg in range(LEGS):
                if legs >> leg & 1:
                    delays[leg] = t_ns - woke_ns
    return tuple(delays)


def checked(
    protocol: Family,
    opening: Rows,
    sent_ns: Sequence[int | None],
    answers: Rows,
    tick: int,
    begun_ns: int,
    given_ns: int,
    answer_ns: int,
) -> Sequence[int | None]:
    """Send time of each frame of `opening`, ns, corrected where its answers show that the clock read late.

    begun_ns, given_ns: just before and just after the frames were given to the bus; answers: frames received
    since; answer_ns: shortest time of a feedback on the wire, 0 without a wire. A feedback within that time
    answers an older frame.
    """
    if given_ns - begun_ns < min(PROMPT_NS, answer_ns):
        return sent_ns
    own = [each for each in received_frames(answers) if protocol.fresh(each, tick, begun_ns + answer_ns)]
    if protocol.traits.unasked_s > 0.0:  # an earlier one may be none to the poll, and does not count
        own = list({protocol.sender(each.frame): each for each in own}.values())
    found: list[int | None] = []
    for frame, t_ns in zip(sent_frames(opening), sent_ns, strict=False):
        legs = protocol.addressed(frame)
        out_ns = [each.t_ns - answer_ns for each in own if protocol.sender(each.frame) in legs]
        found.append(None if t_ns is None else min([t_ns, *out_ns]))
    return found
