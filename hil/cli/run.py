"""The command `hil run`: its options and help text."""

from typing import Any

import click

from hil.cli import shared


@click.command()
@shared.configuration_argument
@shared.flag("--plant with_plant", "Start and supervise `hil plant` at the other end of the bus.")
@shared.flag("--arm", "Let the platform move as soon as all drives are ready, without waiting for Enter.")
@shared.flag("--wait-for-arm", "Wait for `hil ctl CONFIG arm` before the platform moves; needs no terminal.")
@shared.flag("--reset", "Clear faults that the drives have latched before engaging.")
@shared.flag(
    "--release", "Make a running `hil run` switch off the force that holds a platform with a failed brake."
)
@shared.flag("--watch with_watch", "Also start `hil watch`, which prints the link of a live page.")
@shared.duration_option
@shared.log_option
@shared.fault_option
@shared.reporting
def command(configuration: str, release: bool, **options: Any) -> None:
    """Run the controller in real time.

    Waits for six drives, and for the operator's consent to motion: Enter, --arm, or `hil ctl CONFIG arm` from
    another terminal. Then it tests the brakes, moves to the start of the reference, tracks it, parks and
    closes the brakes. Ctrl-C stops along the path and parks; a second Ctrl-C is an emergency stop. The log
    goes to --log, else to runs/NAME-TIME.mcap (recording.folder), with a picture next to it; with --plant the
    plant's own log is NAME-plant. The log is replayed at the end.

    \b
    Examples:
      hil run --plant --arm --watch         all virtual, with a live page; on this machine alone
      hil run --plant --arm --duration 5 --fault "encoder_jump leg=0 at=2 by=5e-3"
      hil run socketcan --reset             real drives on can0; clears faults that the drives have latched

    Guide: docs/guides/first-run.md; at a machine docs/guides/operate.md.
    """
    if release:
        from hil.app.run.command import release_held

        shared.finish("release", release_held(shared.load(configuration)))
    if options["arm"] and options["wait_for_arm"]:
        raise click.UsageError("--arm and --wait-for-arm contradict each other: give one of them.")
    loaded = shared.load(configuration, "run")
    from hil.app.configuration.fault_words import with_faults
    from hil.app.run.command import run_daemon

    if options["faults"] and not options["with_plant"]:
        raise click.UsageError("--fault acts on the plant: add --plant, or give it to `hil plant`.")
    if options["with_plant"]:
        with_faults(loaded, options["faults"]).require("plant")
    shared.finish("run", run_daemon(loaded, **options))
