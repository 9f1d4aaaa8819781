"""Parts of the speed benchmark, one file each; `python -m tools.benchmarks` runs them all."""
