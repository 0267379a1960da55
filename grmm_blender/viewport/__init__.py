"""Splats in Blender's solid and material preview viewports, drawn with the `gpu` module on any graphics card.

One `Viewport` for each 3D region. On the main thread, when Blender draws the region: copy the scene when it changed, ask
`jobs` for Gaussians and their order, draw the newest that came. On a thread: Gaussians from the model or from cloud objects,
packing, sorting. The picture is blended in display colors in a buffer of its own, as the rasteriser does, and then put into
the viewport with one depth for each pixel, so that it hides objects and is hidden by them.

================ =================================================================================
``settings``     `Scene.grmm_viewport`
``changes``      counts changes of scenes and settings
``overlay``      Blender's drawing callbacks and events
``splat_view``   what one region needs between two draws
``bones``        bones that are being posed
``handles``      points of the face that are dragged
``drawing``      textures, batches, draw calls
``shaders``      the GLSL
``jobs``         the thread
``arrays``       Gaussians as arrays in world space, packing, sorting (numpy only)
``sources``      what a viewport shows: avatars and splat clouds
``studio_light`` what lights them there
``panel``        user interface
================ =================================================================================

The rendered viewport is the engine's (`engine.view`).
"""

from __future__ import annotations

from . import handles, overlay, panel, settings

CLASSES = (*settings.CLASSES, *panel.CLASSES, *handles.CLASSES)
PARTS = (settings, overlay)
