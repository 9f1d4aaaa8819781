"""The command `hil plant`: its options and help text."""

import contextlib
import json
import os
from typing import Any

import click

from hil.cli import shared


@click.command()
@shared.configuration_argument
@shared.duration_option
@shared.log_option
@shared.fault_option
@shared.flag("--bench with_bench", "Legs on trestles, for a rehearsal of `hil bringup`.")
@shared.mistake_option
@click.option("--supervisor", type=int, hidden=True)
@click.option("--report", type=int, hidden=True)
@click.option("--watchdog", "watchdog_s", type=float, hidden=True)
@shared.reporting
def command(
    configuration: str,
    faults: tuple[str, ...],
    with_bench: bool,
    mistakes: tuple[str, ...],
    report: int | None,
    watchdog_s: float | None,
    **options: Any,
) -> None:
    """Serve six emulated drives and the plant behind them on the bus, in real time.

    The other end of the bus for `hil run` without hardware, or for another controller. Brakes are engaged at
    boot and after a fault. Ends with Ctrl-C or after --duration. The log, with the true pose, goes to --log,
    else to runs/NAME-TIME-plant.mcap (recording.folder); `plant.log: false` in the configuration writes none.

    \b
    Examples:
      hil plant --duration 60 --fault "drive_silence leg=2 at=5 for=0.5"
      hil plant --bench --mistake "ids_swapped leg=1 other=4"   then, in another terminal: hil bringup

    Guide: docs/guides/foreign-controllers.md.
    """
    loaded = shared.load(configuration, "plant")
    from hil.app.configuration.fault_words import with_faults
    from hil.app.plant import run_plant

    if mistakes and not with_bench:
        raise click.UsageError("--mistake changes the wiring of the bench: add --bench.")
    loaded = with_faults(loaded, faults)
    if watchdog_s is not None:  # a slowed loop's, as if set with the maker's tool
        drives = loaded.drives.model_copy(update={"watchdog_ms": 1e3 * watchdog_s})
        loaded = loaded.model_copy(update={"drives": drives})

    def tell() -> None:
        if report is not None:
            os.write(report, b"\n")
        else:
            click.echo("drives are on the bus; Ctrl-C ends", err=True)

    with contextlib.ExitStack() as stack:
        bench = None
        if with_bench:
            from hil.lab.bringup.connection import served_bench

            bench = stack.enter_context(served_bench(loaded, mistakes))
        summary = run_plant(loaded, ready=tell, bench=bench, **options)
    if report is not None:
        with contextlib.suppress(OSError):  # the daemon was killed
            os.write(report, json.dumps(summary).encode())
    shared.finish("plant", summary)
