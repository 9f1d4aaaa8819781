"""`hil watch`."""

from typing import Any

import click

from hil.cli.shared import configuration_argument, finish, option, reporting


@click.command()
@configuration_argument
@option("--host", str, "ADDRESS", "Address or name to listen on.", default="127.0.0.1")
@option("--port", click.IntRange(0, 65535), "N", "Port; without it 8642, or a free one.")
@click.option("--supervisor", "alive", type=int, hidden=True)
@reporting
def command(configuration: str, **options: Any) -> None:
    """Serve a live page about the run on the bus of CONFIG: pose, legs, forces, errors, timing, faults.

    Prints a link, which any browser opens without network. Ctrl-C ends the page, and nothing else. With
    --host others see it, too, and need the token of the link; there is no encryption: use it in a network
    that you trust. With watch.operate in CONFIG the page has buttons, which always need the token.

    \b
    Examples:
      hil watch                             the page of the configuration `virtual`
      hil watch my.yaml --port 9000
      hil watch my.yaml --host 0.0.0.0      for other machines and phones, with a token

    Guide: docs/guides/watch.md.
    """
    from hil.app.configuration.configuration import load
    from hil.app.watch.command import watch

    summary = watch(
        load(configuration),
        announce=lambda link: click.echo(f"hil: watch at {link}", err=True),
        **options,
    )
    finish("watch", summary)
