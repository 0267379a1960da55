"""A walk through a real Blender with a window, as an animator takes it; run by hand and before releases.

``blender``   starts Blender on a virtual screen, presses keys, moves the mouse, runs snippets inside, takes pictures
``inside``    what runs inside that Blender: snippets out of a folder, by a timer
``steps``     the walk: each step does something and is a picture
``corners``   steps that are easily forgotten: menus, other editors, questions, a recording that plays on, no window
``rate``      frames a second that a window plays, with splats and without
``pictures``  the documents' pictures of a window
"""
