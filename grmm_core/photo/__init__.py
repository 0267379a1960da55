"""What a photo shows: faces, landmarks, expression coefficients, the person's outline.

``networks``  runs the converted networks of the asset photo_networks.safetensors
``faces``     face boxes, 478 landmarks, 52 ARKit coefficients

Needs torch; imports nothing of the model. Used by fitting.
"""
