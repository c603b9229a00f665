"""The papers' figures, run again beside what they claim."""
