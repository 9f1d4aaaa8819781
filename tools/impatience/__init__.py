"""Interrupts at any moment of any command: what it says of them, and what it leaves behind."""
