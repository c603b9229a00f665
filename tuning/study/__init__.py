"""One Optuna study: run, race, keep, search, choose."""
