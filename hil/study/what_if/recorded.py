"""What another controller would have answered, as a log that says that it is no run."""

from pathlib import Path

from hil.app.compose import build_scene, databases
from hil.app.configuration.configuration import Configuration
from hil.app.replay import WHAT_IF
from hil.loop.cycle import Cycle
from hil.record import Recording
from hil.record.log import Log
from hil.record.schema import IDENTITY

OPEN_LOOP = (
    "The measurements did not follow the changed forces: past the first difference the loop is open. These "
    "figures say what this controller would have answered to these measurements, not how the robot would "
    "have moved."
)


def record(here: Configuration, cycle: Cycle, path: Path, source: Log) -> Recording:
    """Start the recorder of a what-if on a log; it never runs ahead of its reader.

    What it says first stands at the first tick of the log, whose times it keeps.

    Raises LogError where the log cannot be begun, and where the first row of the other cannot be read.
    """
    begins_ns = source.origin_ns
    recording = Recording.start(
        path,
        configuration=here.text,
        attachments=databases(here),
        metadata={
            "kind": WHAT_IF,
            "what_if_of": source.path.name,
            "what_if_of_kind": source.metadata.get(IDENTITY, {}).get("kind", ""),
            "open_loop": OPEN_LOOP,
            "rate_Hz": cycle.parts.rate_Hz,
            "watchdog_s": cycle.parts.setup.watchdog_s,
            "protocol": here.drives.protocol,
        },
        scene=build_scene(here),
        can_channel=source.can_channels,
        lockstep=True,
        ring_ticks=here.recording.ring_ticks,
    )
    recording.event(begins_ns, "warning", f"a what-if on {source.path.name}, no run. {OPEN_LOOP}")
    return recording
