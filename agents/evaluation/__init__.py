"""What a policy is worth, beside every simpler way of choosing parameters."""
