"""Which poses the platform can reach, and how well it moves and carries there.

A pose counts as reachable if it can be reached from home, on the path that each file names, without leaving
the limits: a pose on the far side of a singularity or of a gap does not count, however good its lengths are.
"""
