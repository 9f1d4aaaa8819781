"""`hil learn`: the feed-forward of the next run, from the logs of those before."""

from pathlib import Path
from typing import Any

import click

from hil.cli.shared import FILE, NOT_NEGATIVE, OUTPUT, POSITIVE, finish_lines, load, option, reporting


@click.command()
@click.argument("sources", metavar="LOG...|CONFIG", nargs=-1, required=True, type=FILE)
@option(
    "-o --out",
    OUTPUT,
    "FILE",
    "CSV of the next run's feed-forward; an earlier one of this command is replaced.",
)
@option("--axes", FILE, "FILE", "Axes that `hil identify` found; default: the configuration's.")
@option(
    "--gain-error",
    NOT_NEGATIVE,
    "X",
    "Without --axes: share by which an axis may be off.",
    default=0.25,
    show_default=True,
)
@option(
    "--delay-error",
    NOT_NEGATIVE,
    "MS",
    "Without --axes: time by which the loop's delay may be off.",
    default=1.0,
    show_default=True,
)
@option(
    "--limit",
    POSITIVE,
    "N",
    "Largest learned force of a leg; default feedforward.limit_N, without it 20 % of limits.force_N.",
)
@option("--runs", click.IntRange(1, 100), "N", "With CONFIG: make so many runs in lockstep.")
@option(
    "--inertia-scale", POSITIVE, "X", "With --runs: masses that the law believes in, as a share of its own."
)
@option(
    "--logs",
    click.Path(exists=True, file_okay=False, path_type=Path),
    "FOLDER",
    "With --runs: keep logs and feed-forwards there; it has to exist.",
)
@reporting
def command(
    sources: tuple[Path, ...],
    out: Path | None,
    axes: Path | None,
    gain_error: float,
    delay_error: float,
    limit: float | None,
    runs: int | None,
    inertia_scale: float | None,
    logs: Path | None,
) -> None:
    """Learn from run to run: a feed-forward of the leg forces over the time of the reference.

    Each call takes the log of the last run and the one before, and writes the feed-forward that the next
    configuration names in section `feedforward`; the first call takes the log of a run without any. A run
    whose error does not fall as predicted is refused. Nothing moves, except with --runs.

    \b
    Examples:
      hil learn runs/first.mcap -o next.csv
      hil learn runs/first.mcap runs/second.mcap -o next.csv
      hil learn runs/first.mcap -o next.csv --axes axes.yaml --limit 800
      hil learn virtual --runs 10 --inertia-scale 0.9 -o learned.csv

    Guide: docs/guides/learning.md.
    """
    from tempfile import TemporaryDirectory

    from hil.app.configuration.feedforward_file import BEGINNING
    from hil.app.files import beginning, new_file, write_whole
    from hil.app.output import console, further
    from hil.lab.learn import report
    from hil.lab.learn.command import Knowledge, learn, rehearse, with_scale

    if runs is None and _is_configuration(sources[0]):
        raise click.UsageError(f"{sources[0]} is a configuration: name logs, or make runs with --runs")
    if out is None and runs is None:
        raise click.UsageError("name the file to write: -o FILE")
    if runs is None and (inertia_scale is not None or logs is not None):
        raise click.UsageError("--inertia-scale and --logs are for --runs")
    if runs is not None and len(sources) != 1:
        raise click.UsageError("--runs takes one configuration")
    if out is not None:
        new_file(out, option="-o", own=beginning("a file of hil learn", BEGINNING))
    known = Knowledge(axes, gain_error, 1e-3 * delay_error, limit)
    believed = None
    if runs is None:
        made = learn(sources, known)
    else:
        c = load(str(sources[0]), "sim")
        if inertia_scale is not None:
            c = with_scale(c, inertia_scale)
            believed = c.controller.believed
        with TemporaryDirectory(prefix="hil-learn-") as folder, console.status("run 0") as status:
            made = rehearse(
                c, runs, known, logs or Path(folder), lambda s: status.update(f"run {s.run.number + 1}")
            )
    unwritten: dict[str, Any] = {}
    if made.best and out is not None:
        with further(unwritten):
            write_whole(out, made.best)
    written = None if unwritten else out
    finish_lines(report.lines(made, written, believed), report.summary(made, written) | unwritten)


def _is_configuration(source: Path) -> bool:
    from hil.app.configuration.text_file import shipped

    return source.suffix in {".yaml", ".yml"} or (not source.exists() and str(source) in shipped())
