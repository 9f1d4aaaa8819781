"""Stores parked leg lengths for motors without absolute encoders: file, updates during a run, command."""
