"""Change indicator: what navgym computes, kept as text, so that a change of it shows as a diff."""
