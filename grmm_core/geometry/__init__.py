"""Where things are: cameras, rotations, and the depth of triangle meshes. Needs numpy only.

``camera``      pinhole and orthographic cameras, as every part agrees on them
``rotations``   Euler angles, axis-angle vectors, quaternions, matrices
``triangles``   normals and areas of meshes
``zbuffer``     depth of triangles as a camera sees them; ``zbuffer_kernel`` is its compiled twin
"""
