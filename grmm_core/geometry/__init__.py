"""Where things are: cameras, rotations, and the depth of triangle meshes. Needs numpy only, but for `tensor_rotations`.

``camera``      pinhole and orthographic cameras, as every part agrees on them
``libraries``   functions that are one text for numpy and torch
``points``      distances between many points
``rotations``   Euler angles, axis-angle vectors, quaternions, matrices; ``tensor_rotations``: those that are differentiated
``triangles``   normals, areas and nearest points of meshes
``zbuffer``     depth of triangles as a camera sees them; ``zbuffer_kernel`` is its compiled twin
"""
