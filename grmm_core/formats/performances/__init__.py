"""Files of recorded performances.

``arkit_json`` ``live_link_csv``       ARKit weights of many programs, Live Link Face
``audio2face_csv`` ``face_cap``        Audio2Face-3D, Face Cap
``flame_npz``                          FLAME parameters, also of CAP4D
``text_table`` ``shapes`` ``turns``    rows of text, names of shapes, angles of heads
``repair``                             missing values, time lines
"""
