"""Learning a hand: objects, data, training and evaluation in so many minutes."""
