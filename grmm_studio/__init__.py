"""Capture studio: random people of a head model, rendered with Cycles into a `grmm_core.data` capture.

Map, without bpy: `subjects` (who), `shots` (which expression, pose and cameras), `lights`, `fields` (where on a head is what),
`styles`, `grooms`, `hair`, `face_hair` and `grooming` (strands), `mesh` (render mesh), `flesh` (soft tissue), `textures`,
`marks`, `teeth` and `wrinkles` (what is painted). With bpy: `materials`, `strands`, `lamps`, `passes`, `scene`; above them
`capture` with its `settings`. `sheet` makes contact sheets.
Called by `grmm capture`; nothing in `grmm_core` or the Blender extension imports this package.
"""
