"""Light sources: the solar disc, the Earth, and environment maps."""
