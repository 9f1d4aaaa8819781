"""Vectors, rotations, linear algebra, linear systems."""
