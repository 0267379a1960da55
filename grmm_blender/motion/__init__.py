"""What moves a head beside its sliders, without taking their place: all of it is Blender's own and works without the extension.

=============  =================================================================================
``features``   the four of them by name: is it there, add it, remove it
``face_bones`` bones on the face
``look_at``    eyes and neck that follow an object
``idle``       blinking and breathing on NLA tracks
``bake``       from these to keys
``lids``       layers of expressions come and go; what closes the upper lids
``parts``      bones, constraints and drivers
``settings``   `Object.grmm_motion`
``panel``      user interface
=============  =================================================================================

Each is a layer of expressions (`rig.layers`), constraints on bones, or both.
"""

from __future__ import annotations

from . import panel, settings

CLASSES = (*settings.CLASSES, *panel.CLASSES)
register, unregister = settings.register, settings.unregister
