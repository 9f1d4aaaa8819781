"""What is synthesised and what is bounded: controllers from weights, and what can be proven of a loop."""
