"""Energy terms, their weights, and the fused kernel that evaluates them with their gradient."""
