"""Construction of a track from a picture of its walls: centre line, race line, splines, speed, walls."""
