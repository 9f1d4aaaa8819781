"""Frames inside a kernel, by their address."""

from drivers.compiled.compiler import record
from drivers.compiled.pointed import records_at
from drivers.frame_array import FRAME

frames_at = records_at(record(FRAME))
"""frames_at(address, count): the elements of FRAME there."""
