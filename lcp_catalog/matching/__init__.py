"""Control points found in an image, and the camera position that follows."""
