"""Recording of a run: `Recording` in the loop's process, a ring in shared memory, a recorder process."""

from hil.record.environment import environment, scheduling
from hil.record.recording import Live, LogSummary, Recording, Scene

__all__ = ["Live", "LogSummary", "Recording", "Scene", "environment", "scheduling"]
