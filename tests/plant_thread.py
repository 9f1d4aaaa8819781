"""The drives of `hil plant` in a thread of this process, for a foreign controller without its imports."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from drivers.can.bus import Bus
from hil.app.compose import build_nodes, build_protocol
from hil.app.configuration.configuration import Configuration
from hil.app.plant import Bench, ProcessFaults, _serve, _Stop
from plant_fmu.drives.nodes import Nodes


@contextmanager
def serving(c: Configuration) -> Iterator[Nodes]:
    """Serve the bus of a configuration as `hil plant` does; gives access to the drives."""
    bus = Bus.open(c.bus, role="plant")
    nodes, physics = build_nodes(c)
    stop, faults = _Stop(), ProcessFaults([], bus.clock.now())
    protocol = build_protocol(c)
    failed: list[Exception] = []

    def serve() -> None:
        try:
            _serve(Bench(nodes, physics, lambda: None), bus, None, stop, None, None, faults, protocol)
        except Exception as error:  # noqa: BLE001 - raised in the test's thread below
            failed.append(error)

    booted_ns = bus.clock.now() + round(1.5e6 * c.drives.heartbeat_ms)
    thread = threading.Thread(target=serve)
    thread.start()
    while nodes.now_ns < booted_ns and thread.is_alive():  # the first steps of an FMU may take long
        time.sleep(0.01)
    try:
        yield nodes
    finally:
        stop.reason = "the test is over"
        thread.join()
        bus.clock.leave()
        bus.close()
        physics.close()
    assert not failed, failed
