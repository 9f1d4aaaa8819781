"""Compiling kernels with Numba, once per source, into a cache of the user's own."""
