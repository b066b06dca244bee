"""Track building from a picture of the walls: centre line, race line, speeds, wall polylines.

All functions here take a grid in the same form: ``occupied``, bool of shape (H, W), is True in
walls, and row 0 is the bottom; ``resolution`` is the side of a cell in m, and ``origin`` (or
``corner``) the lower left corner of cell [0, 0] in m. A closed line is an array of points; the last
point lies one step before the first. ``label`` names a line or a track in errors.
"""
