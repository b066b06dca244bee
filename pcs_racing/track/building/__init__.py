"""From a picture of the walls to a track: centre line, race line, splines, speed, walls."""
