"""What this machine computes with.

``buffers``   memory for pictures, given out again
``devices``   torch's devices and threads
``graphs``    small networks on a graphics card as CUDA graphs (imports torch)
``kernels``   how compiled kernels are cached (loads numba)
``memory``    memory that this process holds
``recent``    the last results of work, by the contents of what it was given
``threads``   one pool for kernels that run without the interpreter lock (loads numba)
"""
