"""What a navigator gets from a catalogue: usable points of a camera, the expected accuracy of its
position, along a trajectory and over time.
"""
