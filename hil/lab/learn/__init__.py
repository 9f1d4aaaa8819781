"""Iterative learning control: what a run teaches the next one over the same reference. Mathematics alone."""
