"""What a fault has to tell: what happened, what the drives said, what was done, what to do next.

Only reads the cycle: nothing here changes what it does.
"""
