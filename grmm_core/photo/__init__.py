"""What a photo shows: faces, landmarks, expression coefficients, the person's outline.

``networks``  runs the converted networks of the asset photo_networks.safetensors
``load``      files of every kind to upright RGB; ``orientation``: which way up a file is, without torch
``faces``     face boxes, 478 landmarks, 52 ARKit coefficients
``landmarks``  what networks say of landmarks, without torch
``head_landmarks``  where the head model's own landmarks are, of which MediaPipe's are some per cent off
``person``    the mask of the person, its edge refined on the picture
``parser``    skin, hair, beard, glasses, hat, clothes and the rest, where the head was tracked (``parser_network``, ``beard``)
``glasses``   what glasses cover, tint and reflect: frames too thin for that, and ``lenses``, outlines around the eyes

Needs torch, but for `orientation`; imports nothing of the model. Used by fitting.
"""
