"""Speed against accuracy of the tiers and of every other approximation, measured."""
