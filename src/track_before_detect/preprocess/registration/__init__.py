"""Where the scene is in each frame: shifts, turns and zooms of the camera."""
