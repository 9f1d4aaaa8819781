"""What can be proven of a loop: error dynamics, ultimate bounds, energy, reaching, the sampled loop."""
