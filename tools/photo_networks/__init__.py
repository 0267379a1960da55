"""Rebuild grmm_core/assets/photo_networks.safetensors: `python -m tools.photo_networks` (see `__main__`)."""
