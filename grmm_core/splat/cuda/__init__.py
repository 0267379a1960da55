"""The CUDA backend; see `grmm_core.splat` for the map. Imports torch: import it only when it is used."""
