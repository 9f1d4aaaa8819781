"""Controller synthesis: an axis, weights for its loop, and the controller that meets them best.

Offline only: this package uses SciPy's LAPACK, opens no file, and is not imported by a loop.
"""
