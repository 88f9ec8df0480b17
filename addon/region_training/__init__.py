"""Region training jobs, and masks painted on photos."""
