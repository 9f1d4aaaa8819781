"""`hil bringup`: from parts to a moving platform, at a bus or on the rehearsal bench."""
