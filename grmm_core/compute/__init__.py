"""What this machine computes with.

``kernels``   how compiled kernels are cached (loads numba)
``memory``    memory that this process holds
"""
