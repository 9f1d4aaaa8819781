"""One module per command; the only place that imports both ends of the bus."""
