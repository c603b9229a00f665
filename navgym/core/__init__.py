"""What every room stands on: checks, compilation, files, parameters, seeds."""
