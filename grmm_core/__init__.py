"""GRMM: a Gaussian Residual Morphable Model of the human head, without Blender.

The map, from the ground up; each part uses only those above it:

``errors``                              typed errors
``compute``                             compiled kernels, devices, memory
``jobs``                                progress of work that takes a while: the record, stages, time left
``files`` ``pictures``                  whole-or-nothing writes, tensor files, `.npz`; color, PNG and EXR
``geometry``                            cameras, rotations, depth of meshes
``controls``                            names of expressions, one frame of animation
``head``                                the mesh model (open head, or FLAME from the user's file)
``light``                               lamps and surroundings, and what they make of colors learned under the studio's rig
``splat``                               the differentiable Gaussian rasteriser and its backends
``hair``                                strands bound to the head's triangles: posed, shaped, colored, drawn as Gaussians
``avatar``                              `.grmm` files, and the library of avatars that come with the package
``model``                               the paper's networks, weights, and the one way from inputs to a picture
``wrinkles``                            furrows that an expression draws into the skin
``inference``                           the model again without torch: numpy, numba and onnxruntime
``performance`` ``formats``             animation files, splat and mesh files
``session``                             open, deform, render: in this process or in a worker process
``data`` ``training``                   capture data sets; losses and the training loop, for many people or one
``photo`` ``fitting``                   what a photo shows; from photos to an avatar
``video`` ``voice``                     from a video of a face, or a recorded voice, to a performance
``evaluation``                          protocols, regions, figures and sheets
``cli``                                 the `grmm` command

Importing this package is light: it loads neither torch nor numba. Nothing in it imports bpy.
"""

from __future__ import annotations

__version__ = "1.0.0"
