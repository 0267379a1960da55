"""Avatars of other projects, and ours in their form.

``gaussian_avatars`` ``cap4d`` ``lam``   one format each
``binding``                              splats on triangles
``flame_transfer``                       an avatar of the open head on the user's FLAME head
"""
