"""Estimates of the platform's pose, of the external wrench on it, and of its state when a force acts."""
