"""The parts of the benchmark, one file each; `tools.benchmarks` runs and prints them."""
