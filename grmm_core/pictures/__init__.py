"""Arrays of pixels: what their numbers mean and how they become files. Needs numpy only, but for ``videos``.

``color``    display sRGB, scene-linear light, straight and premultiplied alpha
``images``   PNG and OpenEXR out
``polygons`` areas that outlines enclose
``sampling`` values between pixels
``videos``   files with moving pictures
"""
