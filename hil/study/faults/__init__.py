"""`hil faults`: injects each kind of fault at each moment of a simulated run, and judges the reactions."""
