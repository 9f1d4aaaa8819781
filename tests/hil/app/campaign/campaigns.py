"""Campaign files for tests, and what several of them ask for."""

import textwrap

SMALL = """
kind: campaign
name: small
configuration: virtual
duration_s: 0.05
sample:
  method: sobol
  count: 2
  seed: 3
  axes:
    friction_N: {key: plant.model.coulomb_friction_N, uniform: [0, 100]}
grid:
  fault:
    faults:
      none: []
      jump: ["encoder_jump leg=1 mode=RELEASING by=5e-3"]
"""
"""Four rows, the second and the last of which end in a fault."""


def written(folder, text, name="c.yaml"):
    """Write a campaign file and return its path."""
    path = folder / name
    path.write_text(textwrap.dedent(text))
    return path
