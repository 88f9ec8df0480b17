"""What steers a training from the scene: regions that are trained again, masks that are painted."""
