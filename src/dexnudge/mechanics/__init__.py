"""Contacts, friction cones and the quasi-static force balance of an object that slides."""
