"""The operator channel: its commands, the socket at the loop's end, and the client at the other end."""
