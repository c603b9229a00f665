"""Training, resumable and repeatable."""
