"""Templates, correlation and sub-pixel fits."""
