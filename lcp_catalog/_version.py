"""The one place where the product's version stands."""

__version__ = "0.3.0"
