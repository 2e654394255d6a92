"""What the data itself says before the solver runs."""
