"""Splat files. `cloud` is what all readers return and writers take: `SplatCloud`.

``ply`` ``splat_file`` ``spz``   3DGS and GaussianAvatars PLY, .splat, SPZ
``sog`` ``gltf_splats``          SOG, glTF with KHR_gaussian_splatting
"""
