"""Other people's filters: programs that replay a log, and functions, tuned as our own are."""
