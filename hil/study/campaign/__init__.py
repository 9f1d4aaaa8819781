"""`hil campaign`: many lockstep runs of one configuration with swept keys, and their failure rate."""
