"""Compilation of kernels with Numba, once per source, into a private cache."""
