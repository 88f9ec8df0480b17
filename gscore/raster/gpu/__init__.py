"""Graphics cards: devices, their self-test, and pictures drawn by them; no torch."""
