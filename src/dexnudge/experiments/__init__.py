"""Every experiment: trials, their records, metrics and tables."""
