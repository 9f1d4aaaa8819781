"""What `hil check` says while a long reference keeps it busy."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hil.app.output import console

FIRST_S, EVERY_S = 5.0, 10.0
"""When the first plain line comes, and how far apart they are."""
DOING = "along the reference, with all that may ride on it"


@contextmanager
def shown() -> Iterator[Callable[[float, float], None]]:
    """Yield what is to be told how far the look along the reference is: s, and of how many.

    A terminal has one line that changes; elsewhere a plain line says it now and then, if it lasts.
    """
    begun = time.monotonic()
    due_s, first = FIRST_S, (0.0, 0.0)
    with console.status(DOING) as status:

        def tell(done_s: float, whole_s: float) -> None:
            nonlocal due_s, first
            elapsed_s = time.monotonic() - begun
            if done_s < first[1] or first == (0.0, 0.0):
                first = elapsed_s, done_s  # the first look, or another one from the beginning
            text = line(done_s, whole_s, elapsed_s - first[0], first[1])
            status.update(text)
            if not console.is_terminal and elapsed_s >= due_s:
                due_s = elapsed_s + EVERY_S
                console.print(text, soft_wrap=True)

        yield tell


def line(done_s: float, whole_s: float, elapsed_s: float, first_s: float) -> str:
    """Return how far it is, in words; the pace since `first_s` were done tells the time left."""
    left = ""
    if done_s > first_s:
        left = f", about {elapsed_s * (whole_s - done_s) / (done_s - first_s):.0f} s left"
    return f"{DOING}: {done_s:.0f} of {whole_s:.0f} s{left}; Ctrl-C ends it"
