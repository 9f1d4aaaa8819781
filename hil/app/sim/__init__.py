"""`hil sim`: simulates controller, bus, drives and plant in lockstep, in simulated time."""
