"""`hil campaign`: many lockstep runs of one configuration with keys swept, and how often they fail."""
