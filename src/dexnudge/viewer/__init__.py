"""Pictures and self-contained 3-D pages of hand configurations."""
