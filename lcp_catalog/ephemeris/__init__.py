"""Times, and the directions of the Sun."""
