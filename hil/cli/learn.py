"""`hil learn`: the feed-forward of the next run, from the logs of earlier runs."""

from pathlib import Path
from typing import Any

import click

from hil.cli import shared

LIMIT = "Largest learned force of a leg; default feedforward.limit_N, else 20 % of limits.force_N."
FOLDER = click.Path(exists=True, file_okay=False, path_type=Path)


@click.command()
@click.argument("sources", metavar="LOG...|CONFIG", nargs=-1, required=True, type=shared.FILE)
@shared.option("-o --out", shared.OUTPUT, "FILE", "CSV of the feed-forward; an earlier one is replaced.")
@shared.option("--axes", shared.FILE, "FILE", "Axes of `hil identify`; default: the configuration's.")
@shared.option("--gain-error", shared.NOT_NEGATIVE, "X", "Relative error of an axis' gain.", default=0.25)
@shared.option("--delay-error", shared.NOT_NEGATIVE, "MS", "Error of the delay.", default=1.0)
@shared.option("--limit", shared.POSITIVE, "N", LIMIT)
@shared.option("--runs", click.IntRange(1, 100), "N", "With CONFIG: number of runs to make in lockstep.")
@shared.option("--inertia-scale", shared.POSITIVE, "X", "With --runs: scale of the law's model masses.")
@shared.option("--logs", FOLDER, "FOLDER", "With --runs: existing folder for logs and feed-forwards.")
@shared.reporting
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

    Each call takes the logs of the last two runs and writes the feed-forward for section `feedforward` of the
    next configuration; the first call takes the log of a run without feed-forward. A run whose error does not
    decrease as predicted is refused. --gain-error and --delay-error apply without --axes.
    Nothing moves, except with --runs.

    \b
    Examples:
      hil learn runs/first.mcap runs/second.mcap -o next.csv --axes axes.yaml --limit 800
      hil learn virtual --runs 10 --inertia-scale 0.9 -o learned.csv

    Guide: docs/guides/learning.md.
    """
    from tempfile import TemporaryDirectory

    from hil.app.configuration.feedforward_file import BEGINNING
    from hil.app.configuration.text_file import shipped
    from hil.app.files import beginning, new_file, write_whole
    from hil.app.output import further
    from hil.lab.learn import report
    from hil.lab.learn.command import Knowledge, learn, rehearse, with_scale

    first = sources[0]
    is_log = first.suffix not in {".yaml", ".yml"} and (first.exists() or str(first) not in shipped())
    if runs is None and not is_log:
        raise click.UsageError(f"{first} is a configuration: give logs instead, or add --runs N")
    if out is None and runs is None:
        raise click.UsageError("the file to write is missing: add -o FILE")
    if runs is None and (inertia_scale is not None or logs is not None):
        raise click.UsageError("--inertia-scale and --logs need --runs N")
    if runs is not None and len(sources) != 1:
        raise click.UsageError("--runs takes one configuration")
    if out is not None:
        new_file(out, option="-o", own=beginning("a file of hil learn", BEGINNING))
    known = Knowledge(axes, gain_error, 1e-3 * delay_error, limit)
    believed = None
    if runs is None:
        made = learn(sources, known)
    else:
        c = shared.load(str(first), "sim")
        if inertia_scale is not None:
            c = with_scale(c, inertia_scale)
            believed = c.controller.believed
        with TemporaryDirectory(prefix="hil-learn-") as folder, shared.status("run 0") as progress:
            made = rehearse(
                c, runs, known, logs or Path(folder), lambda step: progress(f"run {step.run.number + 1}")
            )
    unwritten: dict[str, Any] = {}
    if made.best and out is not None:
        with further(unwritten):
            write_whole(out, made.best)
    file = None if unwritten else out
    shared.finish_lines(report.lines(made, file, believed), report.summary(made, file) | unwritten)
