"""The model without torch: inference in numpy, numba and onnxruntime, which fit into a Blender extension.

``onnx_graph``   ONNX models made in memory
``onnx_networks``the map decoders and the refinement network as such graphs
``loops``        compiled loops (loads numba)
``coarse_loops`` those of refinement at half the resolution
``plain_model``  `PlainModel`, the twin of `model.grmm.GRMM`
``loader``       weights files and avatars' changes to such models

Every part is held to its torch twin by the tests. Used by sessions; nothing here may import torch.
"""
