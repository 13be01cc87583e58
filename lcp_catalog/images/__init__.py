"""Images as missions deliver them: pixels, masks and labels."""
