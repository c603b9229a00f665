"""A network that weighs the modes of the bank."""
