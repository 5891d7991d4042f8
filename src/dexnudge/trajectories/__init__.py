"""Trajectories of an arm and a hand: planned from verified configurations, written for controllers, played in physics."""
