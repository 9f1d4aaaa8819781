"""Names that this machine has once, whichever user asks and in whichever folder."""

import hashlib
import os


def address(*words: str) -> bytes:
    """Return the abstract socket address of what these words name.

    Such a socket leaves no file behind, and the kernel drops it with its process.
    """
    name = hashlib.sha256(os.fsencode("\0".join(words))).hexdigest()
    return b"\0hexapod-hil." + name.encode()
