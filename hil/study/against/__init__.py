"""`hil replay --against`: two logs, and where they part."""
