"""The folder that `sample` writes and `check` reads, and what else commands leave on disk."""
