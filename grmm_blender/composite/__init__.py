"""Avatars in a scene of another engine: Cycles or EEVEE renders the scene, GRMM the avatars, the compositor puts both together.

Blender renders a scene with one engine, so the avatars are rendered in a second scene, the partner. It shows the same
objects through the same camera with the engine GRMM; meshes in front of an avatar already cut it there, with soft edges.

=============  =====================================================================================
``settings``   what is kept in the file: which scene is whose partner, which heads are handed over
``scenes``     the partner scene, and keeping it in step with its main scene
``nodes``      the compositor's nodes, in both of Blender's node systems
=============  =====================================================================================

The head's mesh is hidden from the camera (ray visibility) but stays in the main scene, where it casts shadows and is seen
in mirrors. The engine draws a head that was handed over all the same (see `scene.visibility`). What this cannot do: light of
the main scene does not fall on the avatar, and glass in front of it hides it.
"""

from __future__ import annotations

from . import scenes, settings

CLASSES = settings.CLASSES
PARTS = (settings, scenes)
