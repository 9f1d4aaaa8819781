"""Reference trajectories: pure functions of time that give pose, twist and its rate.

Deterministic to the bit, no clock; only `build` and `sampled` read the configuration or a file, and only
while the trajectory is built. A new kind is one file and one row in `build.BUILDERS`.
"""
