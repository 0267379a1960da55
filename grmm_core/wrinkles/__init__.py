"""Furrows of expressions: what a lifted brow, a frown or a smile draws into the skin, finer than Gaussians and mesh are.

``families``  which shapes drive which furrows, where they lie, how deep they are
``lines``     how they run, painted for one person
``noise``     the smooth functions that both are painted with
``relief``    a person's furrows on the UV map, and their height for an expression
``furrows``   what they do to a picture, at each pixel; ``furrow_kernels`` again, compiled;
              ``shade`` the numbers of both

The studio's people have the same furrows, so that a picture of the model can be held against one of Cycles. A neutral face
has none. Wrinkle maps driven by the expression are the standard way of games and film (Jimenez et al. 2011).
"""
