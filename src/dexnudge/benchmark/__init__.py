"""A benchmark that any method can enter: fixed tasks, an entry as plain files, and one judge for all."""
