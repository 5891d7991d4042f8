"""The learned prior: a conditional diffusion model of hand configurations near an object."""
