"""The studio: a page in the browser in which scenes are changed, sampled and looked at."""
