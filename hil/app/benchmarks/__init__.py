"""The parts of the benchmark, one file each; `hil.app.bench` runs and prints them."""
