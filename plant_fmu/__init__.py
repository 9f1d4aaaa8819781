"""The drives' end of the bus: plant physics, emulated drives, FMU hosting. It never imports ``hil``."""
