"""Obstacles that a command meets on a stranger's machine: folders, rights, limits, a full disk."""
