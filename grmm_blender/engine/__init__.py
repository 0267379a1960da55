"""The GRMM render engine (`bl_idname` "GRMM"): stills, animations, the rendered viewport.

=================  ==============================================================================
``settings``       settings of scenes and view layers
``ui``             panels in the render and view layer properties
``render_engine``  the RenderEngine class; every method delegates
``final``          final renders
``passes``         which passes there are
``occlusion``      what meshes leave of the avatars, kept between pictures (numpy only)
``picture``        from the session's buffers to pass values (numpy only)
``output``         whether there is room for the picture
``pipeline``       a frame from plain values to pass values, on any thread
``view``           the rendered viewport, on Blender's main thread
``view_jobs``      its pictures, on a thread of their own
``overlays``       takes overlays behind avatars out of it
=================  ==============================================================================
"""

from __future__ import annotations

from . import final, render_engine, settings, ui, view

CLASSES = (*settings.CLASSES, *render_engine.CLASSES, *ui.CLASSES)
PARTS = (settings, ui, final, view)
