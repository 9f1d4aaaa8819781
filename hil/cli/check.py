"""The command `hil check`: its options and help text."""

import click

from hil.cli.shared import configuration_argument, counted, finish_lines, load, reporting, write_twin


@click.command()
@configuration_argument
@reporting
def command(configuration: str) -> None:
    """Print the load on bus, legs and limits of CONFIGURATION, before anything moves.

    Bus time of a tick, forces and lengths at home and along the whole reference, drive watchdog, delay,
    stability proof of the control law, real-time rights of this machine. An invalid configuration is refused
    with all its problems at once, each as FILE:LINE:COLUMN: path: what, allowed, given.

    \b
    Examples:
      hil check                             the default configuration
      hil check my.yaml --json my-check.json

    Guide: docs/guides/configuration.md.
    """
    from drivers.errors import HilError

    try:
        loaded = load(configuration)
        from hil.app.check.command import inspect

        with counted("along the reference, s") as seen:
            report = inspect(loaded, lambda done_s, of_s: seen(round(done_s), round(of_s)))
    except HilError as error:
        problems = list(getattr(error, "problems", [str(error)]))
        write_twin({"success": False, "kind": "check", "problems": problems})
        raise
    whole = click.get_current_context().params["verbose"]
    finish_lines(report.text(whole=whole), {"success": True, "kind": "check", **report.to_dict()})
