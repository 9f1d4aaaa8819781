"""`hil stability`."""

from pathlib import Path

import click

from hil.cli.shared import NOT_NEGATIVE, FiniteRange, configuration_argument, finish_lines, load, reporting


@click.command()
@configuration_argument
@click.option(
    "--disturbance-force",
    "force",
    type=NOT_NEGATIVE,
    default=0.0,
    metavar="N",
    help="Unknown force on the platform, of any direction, changing as it likes.",
)
@click.option(
    "--disturbance-torque",
    "torque",
    type=NOT_NEGATIVE,
    default=0.0,
    metavar="N_M",
    help="Unknown torque about the platform's origin, likewise.",
)
@click.option(
    "--model-error",
    type=FiniteRange(min=0, max=1, max_open=True),
    default=0.0,
    metavar="SHARE",
    help="Masses and inertias that the law believes are wrong by this share, either way: 0.1 is 10 %.",
)
@reporting
def command(
    configuration: str, force: float, torque: float, model_error: float, json_file: Path | None
) -> None:
    """Say what is proven of the law of CONFIGURATION, by which function, and under which conditions.

    \b
    proven        a Lyapunov function, its conditions checked along the reference
    conditional   proven if the conditions listed hold; they are not checked here
    not proven    no theorem applies; says nothing against the law
    unstable      refuted: an eigenvalue of the sampled loop lies outside the unit circle

    \b
    Laws that linearise the robot (inverse dynamics in joint and pose space, without H):
      V = x^T P x from the Lyapunov equation, its decay, and the ultimate bound of the error
      under the stated load and model error. The load becomes an acceleration of each leg by
      J M^-1 w along the reference, and the bound is that of the reachable ellipsoid.
    Sliding mode and robust inverse dynamics: the reaching condition, the boundary layer, the
      time to it; from section uncertainty, or from the load given here.
    PD, PD with gravity, feed-forward, Cartesian PD: the energy as V, LaSalle, and the largest
      sublevel set within stroke and away from singularities. For a reference at rest.
    PID: eigenvalues at the reference's start. Designed controllers: those of the sampled loop.
    All: eigenvalues and margins of the loop as it is sampled, held and late.

    \b
    Examples:
      hil stability                                      the default configuration
      hil stability virtual --disturbance-force 10000    and 10 kN that nobody measures
      hil stability my.yaml --disturbance-force 2000 --model-error 0.1 --json proof.json

    \b
    Exit code:
      0  proven, or conditional
      1  not proven, or unstable
      2  refused: the configuration, an option or the file
    """
    from hil.app.output import console

    loaded = load(configuration)
    with console.status("looking for a proof"):
        from hil.app.stability.command import assess, shown

        summary = assess(loaded, force_N=force, torque_N_m=torque, model_error=model_error)
    finish_lines(shown(summary), summary, json_file)
