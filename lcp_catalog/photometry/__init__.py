"""Laws of reflection, their published parameters, and maps of albedo."""
