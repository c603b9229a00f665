"""Pages, tables, figures and words."""
