"""From photos to an avatar (paper, section 3.5).

``types``              what tracking finds in one photo, and its file
``landmark_stage``     camera, shape, expression and pose from landmarks
``photometric_stage``  light, and the refinement by outline and shading
``track``              photos to tracks
``overlay``            pictures of a track, to look at
``invert``             tracks to codes and decoders (eq. 19 and 20)
``api``                all of it, for the command line and Blender

`types` and `landmark_stage` need numpy only; the rest needs torch.
"""
