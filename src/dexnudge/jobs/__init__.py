"""Many tasks at once, in processes of this machine or on a Ray cluster, and bars that show how far they are."""
