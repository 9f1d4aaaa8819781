"""`make fuzz`: untrusted input, damaged at random from a seed; every answer has to be one quick line."""
