"""Iterative learning control: each run improves the feed-forward of the next run over the same reference."""
