"""Area means and interpolated heights."""
