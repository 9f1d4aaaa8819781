"""`make fuzz`: the program reads randomly damaged input, and must answer with one message, in time."""
