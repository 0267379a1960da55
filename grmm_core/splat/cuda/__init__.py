"""The CUDA backend; see `grmm_core.splat` for the map. Imports gsplat: import it only when it is used."""
