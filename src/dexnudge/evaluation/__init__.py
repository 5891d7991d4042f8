"""Whether configurations succeed, over one scene or many: the judge, experiments and their report."""
