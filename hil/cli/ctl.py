"""`hil ctl`."""

import click

from hil.cli.shared import POSITIVE, finish_briefly, finish_lines, option, reporting


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("configuration")
@click.argument("words", nargs=-1, required=True, metavar="WORD [ARGUMENTS]")
@option("--for seconds", POSITIVE, "S", "Let go of the key, or of the jog, after S seconds.")
@reporting
def command(configuration: str, words: tuple[str, ...], seconds: float | None) -> None:
    """Operate a running `hil run CONFIGURATION` from another terminal.

    \b
    Words:
      status        mode, faults, speed, pose, and what the controller waits for
      arm           let the platform move, as Enter in the terminal of `hil run`
      start         go on along the path, or begin it (operator.start: asked)
      hold          slow down along the path to rest and stay, brakes open
      speed P       speed along the path in percent, 0 .. 100; it changes smoothly
      jog AXIS F    from hold, move along x, y, z, turn about rx, ry, rz, or move leg0 .. leg5
                    alone, at F (-1 .. 1) of the set-up speed, until Ctrl-C, or for --for S
      park          back to the first pose at set-up speed, brakes shut
      stop          stop along the path, brakes shut, as Ctrl-C
      estop         drives off and brakes shut, at once
      reset         clear latched faults; arm is the next step
      key           hold the key (operator.deadman_s) until Ctrl-C, or for --for S
      release       let go of a platform that force holds because a brake failed
      setpoint ...  x y z in m and the rotation vector in deg, for a live reference
      end           end a run that stays (operator.stays)

    All words are inputs of the controller, stand in its log and are replayed. None of them is a safety
    function: keep the emergency stop of the hardware at hand.

    \b
    Examples:
      hil ctl my.yaml status
      hil ctl my.yaml speed 25
      hil ctl my.yaml key --for 10
      hil ctl my.yaml jog leg3 -0.5

    Guide: docs/guides/operate.md.
    """
    from hil.app import operate
    from hil.app.configuration.address import address

    if seconds is not None and words[0] not in operate.REPEATED:
        raise click.UsageError("--for goes with the words key and jog.")
    bus = address(configuration).bus
    if words == ("status",):
        summary = operate.status(bus)
        finish_lines(operate.status_lines(summary), summary)
    if words == ("key",) and seconds is None:
        click.echo("the key is held; Ctrl-C lets go of it", err=True)
    if words == ("key",) or words[0] == "jog":
        finish_briefly("ctl", operate.repeat(bus, words, seconds))
    finish_briefly("ctl", operate.command(bus, words))
