"""Greyscale images, PNG files, SVG drawings and HTML pages."""
