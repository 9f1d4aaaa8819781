"""Where the legs were parked, for motors that forget their turns: the file, its keeping, the command."""
