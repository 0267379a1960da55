"""The compiled CPU rasteriser; see `grmm_core.splat` for the map. Imports numba: import it only when it is used."""
