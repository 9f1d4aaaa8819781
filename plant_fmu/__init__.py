"""The other end of the bus: plant physics, emulated drives and FMU hosting. Never imports ``hil``."""
