"""Poses that the platform can reach within its limits, and its dexterity and leg forces there.

A pose is reachable if a path from home leads to it within the limits; each file states its paths. A pose
beyond a singularity or a gap does not count, even if its leg lengths are allowed.
"""
