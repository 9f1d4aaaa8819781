"""Reference trajectories: pure functions of time for pose, twist and dtwist.

Deterministic to the bit, without a clock. Only `build` and `sampled` read the configuration or a file, and
only while the trajectory is built. A new kind needs one file and one row in `build.BUILDERS`.
"""
