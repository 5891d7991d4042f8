"""Objects: built-in shapes, mesh files, and sets of them."""
