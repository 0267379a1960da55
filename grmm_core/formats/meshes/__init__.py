"""Triangle meshes: `mesh` in memory, `.obj` files (``obj``), `.glb` files with morph targets (``gltf_mesh``)."""
