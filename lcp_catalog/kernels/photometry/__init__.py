"""Laws of reflection evaluated on arrays."""
