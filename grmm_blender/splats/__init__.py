"""Splat clouds in a Blender scene: imported splat files, and the splats of other projects' avatars.

A cloud is a mesh object whose vertices are its Gaussians; everything else about them is in attributes of the points, so that
clouds are saved, copied, appended, edited and undone like any mesh, and modifiers and geometry nodes work on them:

=============  =============  =====================================================================================
``position``   Vector         centres in the object's axes, metres
``rotation``   Quaternion     wxyz, in the object's axes
``scale``      Vector         standard deviations along the Gaussian's own axes, metres
``opacity``    Float          0..1
``sh_0`` ...   Vector         spherical harmonics of display sRGB as in 3DGS, in head axes (y up); 1, 4, 9 or 16 of them
``triangle``   Integer        optional: triangle of the carrier that the Gaussian rides on
=============  =============  =====================================================================================

Without ``triangle`` the evaluated positions are drawn: shape keys, drivers and modifiers move Gaussians (LAM's avatars). With
it, a carrier mesh (`Object.grmm_cloud.carrier`) moves them: positions and rotations are those of the carrier's resting shape
(GaussianAvatars, CAP4D).

=================  ======================================================================================
``properties``     `Object.grmm_cloud`: what makes an object a cloud
``cloud``          `Cloud`: an object as splats; `CloudShot`: plain values of one frame
``build``          objects from files
``pictures``       decodes the pictures inside SOG files by Blender
``rigged``         objects from other projects' avatars
=================  ======================================================================================
"""

from __future__ import annotations

from .cloud import Cloud, CloudShot, is_cloud

__all__ = ["Cloud", "CloudShot", "is_cloud"]
