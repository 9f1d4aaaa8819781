"""The bring-up of a machine: a procedure of steps, pure of bus, terminal and clock."""
