"""`make demo`: the whole path from an empty Blender to pictures.

``__main__``     the steps and their order
``performance``  the project's own short performance, written as an ARKit JSON file
``scene``        the Blender part: install the built extension, add a head, import, render (starts bpy)
``sheet``        the contact sheet, drawn from pictures of the same avatar
"""
