"""Hosting of any FMU for co-simulation, in this process or a child's."""
