"""Six emulated drives in front of a plant: states, encoders, brakes, sensors, faults."""
