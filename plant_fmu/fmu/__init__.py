"""Hosting of any FMU for co-simulation, in this process or in a child process."""
