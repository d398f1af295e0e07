"""What is drawn in a window: bodies, skeletons, points, light."""
