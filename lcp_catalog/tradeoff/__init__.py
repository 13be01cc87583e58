"""Speed against accuracy of the tiers, measured."""
