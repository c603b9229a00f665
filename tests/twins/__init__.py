"""Readable numpy versions of the filters, written from the equations and not from the kernels.

Each takes a model, times, measurements and loss flags and returns a dict with the arrays of
`navgym.Estimate`. They use dense solves, explicit loops over lists and J x J matrices: slow, plain,
and independent of how the kernels arrange the same arithmetic.
"""
