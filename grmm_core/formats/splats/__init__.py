"""Splat files. `cloud` is what all readers return and writers take: `SplatCloud`.

``ply`` ``compressed_ply``          3DGS and GaussianAvatars PLY, PlayCanvas's packed one
``splat_file`` ``ksplat`` ``spz``    .splat, .ksplat, SPZ
``sog`` ``webp`` ``gltf_splats``     SOG and its pictures, glTF with KHR_gaussian_splatting
"""
