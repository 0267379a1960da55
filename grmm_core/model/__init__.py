"""The morphable model: decoders, UV-anchored Gaussians, refinement network, weights, and the one forward chain.

The map:

``config``        sizes and switches, presets (standard library only)
``parameters``    names and shapes of a configuration's parameters
``inputs``        `ModelInputs`: what draws one frame, from a person and controls; cache keys
``layout``        which texels carry Gaussians, and constant tables of them
``texels``        Gaussians anchored to the UV map of a mesh; ``placing`` is its compiled twin, ``sparse`` its matrices
``mesh_decoder``  learned vertex displacements, eq. 5-11
``decoders``      maps of Gaussian attributes, eq. 12 and its decoders
``refine``        screen-space refinement network, eq. 14
``grmm``          `GRMM`: inputs -> mesh -> Gaussians -> picture, which everything draws with
``steps``         parts of the chain that are one text for torch and numpy
``detail``        levels of detail
``weights_file``  weights files as arrays, their basis maps in eight bits
``weights``       a model out of such a file, and back
``store``         weights in memory, with the changes of single avatars; ``torch_loader`` loads them for torch
``renewed``       an avatar's changes where later weights draw a region anew
``lip_line``      the borders of lips in colors of weights that have them elsewhere
``people``        avatars that weights know, or that are drawn from them
``portrait``      the portrait camera, portraits and thumbnails

`config`, `parameters`, `inputs`, `layout`, `steps`, `lip_line`, `detail`, `weights_file`, `store`, `people` and `portrait` are
imported without torch. Used by `inference`, `session`, `training`, `fitting` and `evaluation`. `docs/equations.md` lists which
function holds which equation of the paper.
"""

from __future__ import annotations
