"""`hil bringup`: the command, and its procedure of steps, which is free of bus, terminal and clock."""
