"""From photos to an avatar (paper, section 3.5).

``types``              what tracking finds in one photo, and its file
``point_rig``          points of the head, such as landmarks, with exact derivatives
``solver``             robust least squares over cameras, shape, expression and pose
``landmark_priors``    how exact landmarks are, how likely expressions and cameras
``landmark_stage``     camera, shape, expression and pose from landmarks
``photometric_stage``  light, and the refinement by outline and shading
``track``              photos to tracks
``overlay``            pictures of a track, to look at
``measure``            shape error on people whose shape is known
``invert``             tracks to codes and decoders (eq. 19 and 20)
``api``                all of it, for the command line and Blender

`types` and the landmark modules need numpy only; the rest needs torch.
"""
