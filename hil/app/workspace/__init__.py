"""`hil workspace`: where the platform can go."""
