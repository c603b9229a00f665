"""What is in a log and what is wrong with it, before anything is made of it."""
