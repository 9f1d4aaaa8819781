"""One module for each command; the only package that imports both ends of the bus."""
