"""Studies of filters' parameters, comparisons, reports."""
