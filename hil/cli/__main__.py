"""Entry point of `python -m hil.cli`, the same program as `hil`."""

from hil.cli import main

main()
