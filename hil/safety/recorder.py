"""Rule on the recorder: the run can go on without it, but not silently."""

from drivers.compiled.compiler import helper


@helper
def recorder_losing(alive: bool, dropped: int, dropped_before: int) -> bool:
    """Tell whether the recorder is dead or has lost ticks since the last look."""
    return not alive or dropped > dropped_before


def recorder_stop(losing: bool, on_loss: str) -> bool:
    """Tell whether a recorder that is `losing` asks for a controlled stop; `on_loss` is continue or stop."""
    return losing and on_loss == "stop"
