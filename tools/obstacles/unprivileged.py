"""What keeps root from walking through obstacles: without capabilities, rights of files hold for root."""

import ctypes
import errno
import os

_PR_CAPBSET_DROP = 24
_PR_SET_SECUREBITS = 28
_NOROOT = 0x3
"""SECBIT_NOROOT and its lock: a program that uid 0 executes gets no capability for that."""


def drop_capabilities() -> None:
    """Give up, in this process and all that it executes, what lets root ignore rights of files.

    A process that has none loses nothing. Raises OSError.
    """
    if os.geteuid() != 0:
        return
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_SECUREBITS, _NOROOT, 0, 0, 0):
        raise OSError(ctypes.get_errno(), "capabilities cannot be given up")
    for capability in range(64):
        if libc.prctl(_PR_CAPBSET_DROP, capability, 0, 0, 0):
            if ctypes.get_errno() == errno.EINVAL:  # no such capability: the last one was before it
                return
            raise OSError(ctypes.get_errno(), "capabilities cannot be given up")
