"""Guidance rules: how the scene's losses steer the reverse diffusion."""
