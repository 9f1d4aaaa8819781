"""The command `hil ctl`: its options and help text."""

import click

from hil.cli import shared


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("configuration")
@click.argument("words", nargs=-1, required=True, metavar="WORD [ARGUMENTS]")
@shared.option("--for seconds", shared.POSITIVE, "S", "Release the key, or end the jog, after S seconds.")
@shared.reporting
def command(configuration: str, words: tuple[str, ...], seconds: float | None) -> None:
    """Operate a running `hil run CONFIGURATION` from another terminal.

    \b
    Words:
      status        mode, faults, speed, pose, and what the controller waits for
      arm           let the platform move, as Enter in the terminal of `hil run`
      start         continue along the path, or begin it (operator.start: asked)
      hold          slow down along the path to rest and stay, brakes open
      speed P       speed along the path in percent, 0 .. 100; it changes smoothly
      jog AXIS F    from hold, move along x, y, z, turn about rx, ry, rz, or move leg0 .. leg5
                    alone, at F (-1 .. 1) of the set-up speed, until Ctrl-C, or for --for S
      park          back to the first pose at set-up speed, brakes shut
      stop          stop along the path, brakes shut, as Ctrl-C
      estop         drives off and brakes shut, at once
      reset         clear faults of controller and drives; then arm
      key           hold the key (operator.deadman_s) until Ctrl-C, or for --for S
      release       switch off the force that holds a platform with a failed brake
      setpoint ...  x y z in m and the rotation vector in deg, for a live reference
      end           end a run that stays (operator.stays)

    All words are inputs of the controller; they are recorded in its log and replayed. None of them is a
    safety function: keep the emergency stop of the hardware within reach.

    \b
    Examples:
      hil ctl my.yaml speed 25
      hil ctl my.yaml jog leg3 -0.5 --for 10

    Guide: docs/guides/operate.md.
    """
    from hil.app import operate
    from hil.app.configuration.address import address

    if seconds is not None and words[0] not in operate.REPEATED:
        raise click.UsageError("--for applies only to key and jog: leave it out.")
    bus = address(configuration).bus
    if words == ("status",):
        summary = operate.status(bus)
        shared.finish_lines(operate.status_lines(summary), summary)
    if words == ("key",) and seconds is None:
        click.echo("the key is held; Ctrl-C releases it", err=True)
    shared.finish("ctl", operate.say(bus, words, seconds))
