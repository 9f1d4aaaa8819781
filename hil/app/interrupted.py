"""A KeyboardInterrupt that says what there is by then; the command line prints it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def leaving(there: Callable[[], str]) -> Iterator[None]:
    """Add to a KeyboardInterrupt, where it says nothing yet, what there is: it is called then."""
    try:
        yield
    except KeyboardInterrupt as interrupt:
        if str(interrupt):
            raise
        raise KeyboardInterrupt(there()) from None
