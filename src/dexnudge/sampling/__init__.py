"""Sampling: guided reverse diffusion, projection, and the baselines."""
