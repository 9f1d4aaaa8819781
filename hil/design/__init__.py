"""Synthesis of controllers from weights, and stability proofs of the control loop."""
