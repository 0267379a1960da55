"""A scene as plain values: what the engine, the viewport, exporters and contact sheets know of it.

One pass over the evaluated scene (`walk`) finds everything; what it yields is copied into plain values (`shot`), which refer
to none of Blender's data and may cross threads. Each kind of thing has one module that knows how to read it.

=============  =========================================================================================
``shot``       the plain values: avatars, meshes, a scene, a frame
``visibility`` who is shown to the camera of a render, and who cuts holes
``avatars``    avatars: of a scene, and as an evaluated scene shows them
``clouds``     splat clouds, likewise
``meshes``     triangles of everything else, kept between pictures
``world``      the background
``lights``     lamps and the world as light; ``photo_light``: that of the photo that an avatar was made from
``cameras``    the render's camera, that of a viewport, and those of portraits
``walk``       the one pass, and the shots made from it
=============  =========================================================================================
"""
