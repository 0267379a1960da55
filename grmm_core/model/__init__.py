"""The morphable model: decoders, UV-anchored Gaussians, refinement network, weights files.

The map:

``config``        sizes and switches, presets (standard library only)
``texels``        Gaussians anchored to the UV map of a mesh
``mesh_decoder``  learned vertex displacements, eq. 5-11
``decoders``      maps of Gaussian attributes, eq. 12 and its decoders
``refine``        screen-space refinement network, eq. 14
``grmm``          `GRMM`, which composes all of these
``parameters``    names and shapes of a configuration's parameters
``weights_file``  weights files as arrays; ``packing`` stores their basis maps in eight bits
``weights``       a model out of such a file, and back
``layout``        which texels carry Gaussians, and constant tables of them

Used by `session`, `training`, `fitting` and `evaluation`. `config`, `parameters`, `weights_file`, `packing` and `layout` need
numpy only, the rest torch; nothing here imports bpy. `docs/equations.md` lists which function holds which equation of the
paper.
"""

from __future__ import annotations
