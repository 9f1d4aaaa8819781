"""What the controller answers to a line: client and channel share it, and it costs neither an import."""

TAKEN = "taken"
REFUSED = "refused: "
"""Before the reason."""
