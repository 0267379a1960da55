"""Pictures of the panels and the viewport for the documentation, from a real Blender window.

``shims``    what the extension needs and an older Blender lacks
``pictures``  the script that runs inside Blender: adds a head, arranges the window, saves screenshots
``assemble``  outside Blender: crops them into docs/images

The window is that of whatever `blender` is at hand; Debian's is 3.4, older than the extension supports. The panels' and the
viewport's own code runs unchanged there; what the shims leave out is listed in `shims`.
"""
