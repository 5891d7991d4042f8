"""Files of other tools, written and read: one file for each format."""
