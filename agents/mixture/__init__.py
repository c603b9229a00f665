"""A mixture of fixed filters, weighed by what is seen of the samples."""
