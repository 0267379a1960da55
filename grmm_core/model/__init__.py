"""The morphable model: decoders, UV-anchored Gaussians, refinement network, weights files.

The map:

``config``        sizes and switches, presets (standard library only)
``texels``        Gaussians anchored to the UV map of a mesh
``mesh_decoder``  learned vertex displacements, eq. 5-11
``decoders``      maps of Gaussian attributes, eq. 12 and its decoders
``refine``        screen-space refinement network, eq. 14
``grmm``          `GRMM`, which composes all of these
``weights``       weights files
``packing``       eight-bit storage of basis maps in them

Used by `session`, `training`, `fitting` and `evaluation`. Everything but `config` imports torch; nothing here imports bpy.
`docs/equations.md` lists which function holds which equation of the paper.
"""

from __future__ import annotations
