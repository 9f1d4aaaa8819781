"""`hil stability`: stability proofs for the configured law."""
