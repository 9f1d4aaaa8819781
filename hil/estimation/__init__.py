"""Where the platform is, what pushes it, and where it will be when the force acts."""
