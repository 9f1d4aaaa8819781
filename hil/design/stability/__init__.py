"""Stability of the control loop: error dynamics, ultimate bounds, energy, reaching, the sampled loop."""
