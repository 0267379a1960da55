"""How furrows take light, as both forms of `furrows.draw` have it."""

LEVELS = 4  # sizes of the relief: each half of the last
TILT = 0.42
"""Share of the relief's slope that the normal takes: the studio's material takes 0.6, Gaussians are softer than its skin."""
GROOVE = (0.19, 0.28, 0.28)  # of the light, by color, that the deepest groove loses: blood leaves it red
DEPTHS = -1.25, 0.5  # limits of a height by `LINE_DEPTH` that counts as deep
DARKEST, BRIGHTEST = 0.4, 1.3
"""Limits of the factor: a scene's lamp may leave a slope without any light."""
