"""The surface of an area as a heightfield, its surroundings, and occlusion."""
