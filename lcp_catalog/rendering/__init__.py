"""A render: the request, the scene plan, and the images."""
