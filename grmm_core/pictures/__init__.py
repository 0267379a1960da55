"""Arrays of pixels: what their numbers mean and how they become files. Needs numpy only.

``color``    display sRGB, scene-linear light, straight and premultiplied alpha
``images``   PNG and OpenEXR out
``sampling`` values between pixels
"""
