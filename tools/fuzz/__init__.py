"""`make fuzz`: what strangers hand in, damaged at random from a seed: every answer is one line, and soon."""
