"""How long a run in progress goes on: budget, goals, and the steps that it takes anew."""
