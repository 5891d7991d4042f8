"""The judge: what a hand configuration must meet to succeed."""
