"""Controller synthesis from weights, and stability proofs of a loop."""
