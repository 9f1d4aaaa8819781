"""The parts of the benchmark, one file each; `tools.benchmarks` runs them and prints their figures."""
