"""`hil check`."""

from __future__ import annotations

from pathlib import Path

import click

from hil.cli.shared import announce_compilation, configuration_argument, guarded, json_option


@click.command("check", short_help="Figures and problems of a configuration; nothing moves.")
@configuration_argument
@json_option
@guarded
def check_command(configuration: str, json_file: Path | None) -> None:
    """Say what the bus, the legs and the limits have to say about CONFIGURATION, before anything moves.

    Bus time of a tick with its arithmetic, forces and lengths at home and along the whole reference, drive
    watchdog, delay against the law's bandwidth, what is proven of the law (more: hil stability), real-time
    rights of this machine. Opens no bus, writes no log.

    \b
    Examples:
      hil check                             the default configuration
      hil check my.yaml --json my-check.json

    \b
    Exit code:
      0  usable; read the warnings
      2  not usable: all problems at once, each as FILE:LINE:COLUMN: path: what, allowed, given
    """
    from drivers.errors import ConfigurationError
    from hil.app.configuration.configuration import load
    from hil.app.output import show_lines, write_json

    try:
        loaded = load(configuration)
        announce_compilation()
        from hil.app.check.command import inspect

        report = inspect(loaded)
    except ConfigurationError as error:
        if json_file is not None:
            problems = list(error.problems)
            write_json(json_file, {"success": False, "kind": "check", "problems": problems})
        raise
    show_lines(report.lines)
    if json_file is not None:
        write_json(json_file, {"success": True, "kind": "check", **report.to_dict()})
