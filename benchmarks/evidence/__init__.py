"""What the product claims against what happens: photographs, and frames by an independent renderer."""
