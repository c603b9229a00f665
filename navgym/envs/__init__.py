"""What the Gymnasium environments of all problems share."""
