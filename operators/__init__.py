"""Blender operators, one topic a file. Each module has a tuple `CLASSES`.

``common``              what they share
``importing``           what operators that import files share
``file_formats``        what the file browsers take from the list of formats
``add_head``            add an avatar to the scene
``add_flame``           add the user's own FLAME head
``import_performance``  keyframes from ARKit JSON and Live Link Face CSV
``recordings``          what imports of recordings share, and their cancel button
``import_video``        keyframes from a video of a face
``import_voice``        keyframes from a recorded voice
``import_splats``       splat files and other projects' avatars
``save_avatar``         avatar files
``export_splats``       splat files, meshes, GaussianAvatars' folders
``export_animation``    performance files; caches through Blender's Alembic and USD exporters
``fit``                 avatars from photos
``steps``               long work with progress and cancel
``hair``                hair by its picture, and as Blender's curves
``drag_face``           handles of the face in the viewport
``keying``              the keying set of all controls
``edit``                reset, mirror, random expression and identity, independent copies
``residual``            random learned detail, saved codes and their blend
``motion``              face bones, Look At, blinking, breathing
``calibrate``           make the face of chosen frames the neutral one
``relink``              choose an avatar's file again
``composite``           Cycles or EEVEE scenes with their avatars
``bake_world``          a world's light as a picture
``pose_library``        poses as assets
``portrait_camera``     a camera before the avatar
``turntable``           a camera around the avatar
``contact_sheet``       many small pictures in one file

Nothing imports this package but the table of the extension's entry point, which registers it; nothing calls an operator of it
through `bpy.ops`.
"""

from __future__ import annotations

from . import (
    add_flame,
    add_head,
    bake_world,
    calibrate,
    composite,
    contact_sheet,
    drag_face,
    edit,
    export_animation,
    export_splats,
    fit,
    hair,
    import_performance,
    import_splats,
    import_video,
    import_voice,
    keying,
    motion,
    portrait_camera,
    pose_library,
    recordings,
    relink,
    residual,
    save_avatar,
    turntable,
)

PARTS = (
    add_head,
    add_flame,
    import_performance,
    import_splats,
    recordings,
    import_video,
    import_voice,
    save_avatar,
    export_splats,
    export_animation,
    edit,
    drag_face,
    keying,
    residual,
    motion,
    calibrate,
    relink,
    hair,
    fit,
    composite,
    bake_world,
    pose_library,
    portrait_camera,
    turntable,
    contact_sheet,
)

CLASSES = tuple(cls for topic in PARTS for cls in topic.CLASSES)
