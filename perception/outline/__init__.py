"""The parts of the contour (paper section 3.1): columns of the ceiling image, wall lines, and where sight ended."""
