"""Structure from motion jobs: cameras of photos or a video, found in the background."""
