"""The operator channel: its words, the socket at the loop's end, and the client at the other."""
