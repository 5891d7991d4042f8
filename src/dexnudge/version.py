"""The version of this package."""

__version__ = "0.19.0"
