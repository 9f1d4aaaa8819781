"""Interrupts at any moment, and machines that give no room or no rights: what each command says of them."""
