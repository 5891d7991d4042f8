"""Generation of configurations to learn from."""
