"""Compiled mathematics of the loop: plain float64 arrays in, new arrays out, no exception, no library.

Rule of the room: +, -, *, / and square root in a fixed order, so that every machine gets the same bits:
no fastmath, no BLAS, no LAPACK, no function of the C mathematics library.
"""
