"""The story of a fault: what happened, the drives' reports, the reaction, and what to do next.

It only reads the cycle and never changes its behaviour.
"""
