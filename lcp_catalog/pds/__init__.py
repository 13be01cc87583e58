"""Labels of the Planetary Data System (PDS3, PDS4) and tables of ISIS cubes."""
