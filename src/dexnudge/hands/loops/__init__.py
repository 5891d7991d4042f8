"""Closed loops and other equalities of MJCF hands, as couplings of their joints."""
