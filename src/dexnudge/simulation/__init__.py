"""Physics in MuJoCo: whether what statics accepts also holds when it moves."""
