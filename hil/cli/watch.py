"""`hil watch`."""

from pathlib import Path

import click

from hil.cli.shared import configuration_argument, finish, reporting


@click.command()
@configuration_argument
@click.option("--host", default="127.0.0.1", metavar="ADDRESS", help="Address or name to listen on.")
@click.option(
    "--port", type=click.IntRange(0, 65535), metavar="N", help="Port; without it 8642, or a free one."
)
@click.option("--supervisor", type=int, hidden=True)
@reporting
def command(
    configuration: str, host: str, port: int | None, supervisor: int | None, json_file: Path | None
) -> None:
    """Serve a live page about the run on the bus of CONFIG: pose, legs, forces, errors, timing, faults.

    It prints a link; any browser opens it, without network. Whatever runs next on the bus is shown by itself.
    The page reads what the recorder shows of the run: the run neither waits for it nor knows of it. Ctrl-C
    ends it, and nothing else.

    Others see the page with --host; the token of the link is needed for everything then. There is no
    encryption: use it in a network that you trust, or through a tunnel. With watch.operate in CONFIG the page
    has buttons too, which need the token on the loopback as well.

    \b
    Examples:
      hil watch                             the page of the configuration `virtual`
      hil watch my.yaml --port 9000
      hil watch my.yaml --host 0.0.0.0      for other machines and phones, with a token

    \b
    Exit code:
      0  ended on request
      2  not begun: configuration, address or port; the message says what
    """
    from hil.app.configuration.configuration import load
    from hil.app.watch.command import watch

    summary = watch(
        load(configuration),
        host=host,
        port=port,
        alive=supervisor,
        announce=lambda link: click.echo(f"hil: watch at {link}", err=True),
    )
    finish("watch", summary, json_file)
