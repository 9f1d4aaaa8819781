"""Implements the commands; the only package that imports both ends of the bus, controller and plant."""
