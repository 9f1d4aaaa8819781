"""Controllers from weights: an axis, what is asked of it, and the controller that gives the most of it.

Offline; SciPy's LAPACK is used freely, no file is opened, and no loop imports it.
"""
