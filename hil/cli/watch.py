"""The command `hil watch`: its options and help text."""

from pathlib import Path
from typing import Any

import click

from hil.cli import shared


@click.command()
@shared.configuration_argument
@shared.option("--host", str, "ADDRESS", "Address or name to listen on.", default="127.0.0.1")
@shared.option("--port", click.IntRange(0, 65535), "N", "Port; without it 8642, or a free one.")
@shared.option(
    "--runs",
    click.Path(path_type=Path, file_okay=False),
    "FOLDER",
    "Folder of the earlier runs; default recording.folder.",
)
@click.option("--supervisor", "alive", type=int, hidden=True)
@shared.reporting
def command(configuration: str, **options: Any) -> None:
    """Serve a live page about the run on the bus of CONFIG: pose, legs, forces, errors, timing, faults.

    Without a run it lists the logs of the folder: verdict, configuration, law, duration, peak error. It opens
    their reports, and two of them side by side.

    Prints a link that any browser opens without network. Ctrl-C ends the page, not the run. With --host other
    machines can open it with the token in the link. There is no encryption: use it in a trusted network. With
    watch.operate in CONFIG the page has buttons, which always need the token.

    \b
    Examples:
      hil watch my.yaml --port 9000
      hil watch my.yaml --host 0.0.0.0      for other machines and phones, with a token

    Guide: docs/guides/watch.md.
    """
    loaded = shared.load(configuration)
    from hil.app.watch.command import watch

    shared.finish("watch", watch(loaded, **options))
