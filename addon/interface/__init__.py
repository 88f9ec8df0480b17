"""What operators and panels share to speak with the user."""
