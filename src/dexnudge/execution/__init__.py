"""Configurations of a result folder played out in physics."""
