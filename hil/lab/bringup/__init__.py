"""`hil bringup`, and its procedure of steps, which is pure of bus, terminal and clock."""
