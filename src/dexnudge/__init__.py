"""dexnudge: hand configurations that push, press or hook what a hand cannot grasp."""

__version__ = "0.6.0"
