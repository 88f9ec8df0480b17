"""Structure from motion jobs: find cameras of photos or a video in the background."""
