"""Stability proofs of a loop: error dynamics, ultimate bounds, energy, reaching, the sampled loop."""
