"""The report of a fault: what happened, what the drives reported, the reaction, what to do next.

The package only reads the cycle and never changes its behaviour.
"""
