"""The dataset: where data generation and the learned model meet."""
