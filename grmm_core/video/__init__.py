"""Performance capture from an ordinary video: a face in front of a phone or a webcam becomes a `Performance`.

=================  =====================================================================================
`request`          `TrackRequest`: what is asked, checked in one place
`reading`          frames of a file, upright
`following`        one face through the frames: 478 landmarks and 52 reported coefficients each
`actor`            the shape of that person and the camera, from the calmest frames or an avatar's file
`solving`          expression and head pose of each frame by least squares
`finishing`        frames without the face, whole blinks, gaze behind shut lids
`api`              `track`: all of it, to a file
=================  =====================================================================================

Reported coefficients alone are a poor performance: of a speaking head whose weights are known, the lips moved by them have a
correlation of 0.64 with the truth, solved from the landmarks 0.90 (docs/video.md). Needs torch and PyAV, but for `request`.
"""
