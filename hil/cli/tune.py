"""The command `hil tune`: its options and help text."""

import click

from hil.cli import shared

MARGIN = "Least additional delay that the loop tolerates; default: that of the gains which `hil new` writes."
FORCE = "Unknown force on the platform, for the error bound; default: a tenth of the platform's weight."


@click.command()
@shared.configuration_argument
@shared.option("--delay-margin delay_margin_ms", shared.POSITIVE, "MS", MARGIN)
@shared.option("--disturbance-force force_N", shared.NOT_NEGATIVE, "N", FORCE)
@shared.reporting
def command(configuration: str, delay_margin_ms: float | None, force_N: float | None) -> None:
    """Choose the gains of CONFIGURATION's law from its delay, friction, masses and encoders.

    Takes friction and rotor mass from the virtual plant, else as the controller's model has them, and the
    delay as stated, else from the frames. Raises the natural frequency until delay margin, phase margin,
    gain margin or force noise reach their limit. Simulates the reference with both sets of gains. Prints
    margins, noise, errors, and the YAML block to paste. CONFIGURATION is not changed.

    \b
    Examples:
      hil tune lab
      hil tune my.yaml --delay-margin 8 --disturbance-force 50 --json gains.json

    Guide: docs/guides/gains.md.
    """
    loaded = shared.load(configuration)
    from hil.study.tune import show, tune

    with shared.status("choosing gains"):
        summary = tune(loaded, delay_margin_ms=delay_margin_ms, force_N=force_N)
    show(summary)
    shared.finish_lines((), summary)
