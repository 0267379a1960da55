"""Files that are whole or not there, and arrays out of files that nobody vouches for. Needs numpy only.

``access``       writes under a temporary name first; reads with one-sentence errors
``tensorfile``   the tensor file format of weights, avatars and checkpoints
``archive``      members of zip archives
``packing``      arrays in eight bits
``npz``          named arrays out of `.npz` files
``format``       what a file format says about itself
"""
