"""Capture studio: random people of a head model, rendered with Cycles into a `grmm_core.data` capture.

Map: `subjects` (who), `shots` (which expression, pose and cameras), `fields` (where on a head is what), `styles`, `grooms`
and `hair` (strands), `mesh` (render mesh), all without bpy; `materials`, `scene` and `capture` use bpy. `sheet` makes
contact sheets.
Called by `grmm capture`; nothing in `grmm_core` or the Blender extension imports this package.
"""
