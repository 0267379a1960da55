"""What exporters take from a session: splats with view dependence, ARKit shapes as morph targets, avatars for other projects.

Called by `grmm export` and by Blender's exporters. Exported colors are those that look right alone, without the refinement
network. Needs numpy only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..controls.frame import Controls
from ..controls.names import ALIGNED_NAMES, ARKIT_NAMES
from ..formats import SplatCloud
from ..formats.avatars.gaussian_avatars import GaussianAvatar
from ..formats.avatars.lam import LamAvatar, vertex_triangles
from ..formats.meshes.mesh import Mesh
from ..head import HeadModel
from ..jobs.progress import Share, nobody
from ..performance import Performance
from ..splat.rules import DILATION
from .api import Session
from .harmonics import fit_harmonics
from .values import AvatarInfo
from .wearing import HairUse

PIXEL = 5.7e-4  # metres of the head, where it fills a picture of 700 lines
_OWN = HairUse()


def splat_cloud(
    session: Session, avatar: AvatarInfo, controls: Controls, sh_degree: int, lod: int = 0, hair: HairUse = _OWN
) -> SplatCloud:
    """Return an avatar's Gaussians with fitted view dependence, head axes.

    Ours are drawn with the compensation of antialiasing, which other programs lack or leave out. What it is at pixels of
    `PIXEL` is in these opacities, so that irises, brows and lashes are not drawn too wide and dark there.

    Args:
        session: Where the avatar is open.
        avatar: An open one.
        controls: Expression and pose.
        sh_degree: 0 to 3.
        lod: As `Session.gaussians`.
        hair: What the avatar wears; its strands are splats like the others.
    """
    found = session.gaussians(avatar.id, controls, lod=lod, hair=hair)
    harmonics = fit_harmonics(session, avatar.id, controls, sh_degree, lod, hair)
    opacities = np.clip(found.opacities, 0.0, 1.0)
    if avatar.antialiased:
        opacities = opacities * _compensated(found.scales)
    return SplatCloud(found.means, found.quats, found.scales, opacities, harmonics)


def _compensated(scales: np.ndarray) -> np.ndarray:
    """`splat.compensation` of Gaussians of standard deviations [N, 3] metres, seen broadside at pixels of `PIXEL`, [N]."""
    broad = np.sort(np.asarray(scales, np.float64), axis=1)[:, 1:] ** 2
    kept: np.ndarray = np.sqrt((broad / (broad + DILATION * PIXEL**2)).prod(1)).astype(np.float32)
    return kept


def flame_avatar(
    session: Session, avatar: AvatarInfo, controls: Controls, flame: HeadModel, track: Performance, sh_degree: int,
    lod: int = 0, hair: HairUse = _OWN,
) -> GaussianAvatar:  # fmt: skip
    """Return an avatar of the open head as GaussianAvatars store it: splats on the triangles of the user's FLAME.

    Args:
        session: Where the avatar is open.
        avatar: An open one.
        controls: The person at rest.
        flame: The user's head model.
        track: FLAME's parameters of the animation.
        sh_degree: 0 to 3.
        lod: As `Session.gaussians`.
        hair: What the avatar wears.

    Raises:
        ShapeError: The avatar is not of the open head.
        FileFormatError: The head model is not FLAME's.
    """
    from ..formats.avatars.flame_transfer import PROBES, bind_to_flame, fit_flame  # with FLAME's dozen modules

    fit = fit_flame(session.deform(avatar.id, controls).vertices, flame)
    probes = []
    for probe in PROBES:
        raised = controls.validate().set_named(probe)
        probes.append(
            (session.gaussians(avatar.id, raised, lod=lod, hair=hair).means, session.deform(avatar.id, raised).vertices)
        )
    bound = bind_to_flame(splat_cloud(session, avatar, controls, sh_degree, lod, hair), fit, flame, probes)
    return GaussianAvatar(bound, replace(track, static_offset=fit.offset))


def lam_avatar(
    session: Session, avatar: AvatarInfo, controls: Controls, lod: int = 0, report: Share = nobody, hair: HairUse = _OWN
) -> LamAvatar:
    """Return an avatar as LAM's viewer shows it: splats that the ARKit shapes move.

    Args:
        session: Where the avatar is open.
        avatar: An open one.
        controls: The person at rest.
        lod: As `Session.gaussians`.
        report: Hears how much is done.
        hair: What the avatar wears.
    """
    cloud = splat_cloud(session, avatar, controls, 0, lod, hair)
    morphs = _moved(
        lambda raised: session.gaussians(avatar.id, raised, lod=lod, hair=hair).means, controls, ARKIT_NAMES, report
    )
    return LamAvatar(Mesh(cloud.means, vertex_triangles(cloud.count), morphs=morphs), cloud)


def morph_targets(
    session: Session,
    avatar_id: int,
    controls: Controls,
    names: Sequence[str] = ARKIT_NAMES,
    report: Share = nobody,
) -> dict[str, np.ndarray]:
    """Return how aligned expressions at 1 move the posed vertices, [V, 3] metres each, by name.

    Args:
        session: Where the avatar is open.
        avatar_id: The avatar.
        controls: Expression and pose that they are added to.
        names: Which of the 60; the 52 ARKit shapes, of which the others are mixtures, unless told.
        report: Hears how much is done.
    """
    return _moved(lambda raised: session.deform(avatar_id, raised).vertices, controls, names, report)


def _moved(
    positions: Callable[[Controls], np.ndarray], controls: Controls, names: Sequence[str], report: Share
) -> dict[str, np.ndarray]:
    """How far positions [N, 3] go as each of the aligned expressions is raised by 1."""
    resting = positions(controls)
    morphs: dict[str, np.ndarray] = {}
    for number, name in enumerate(names):
        report(number / len(names), name)
        raised = controls.copy()
        raised.aligned[ALIGNED_NAMES.index(name)] += 1.0
        morphs[name] = positions(raised) - resting
    report(1.0)
    return morphs
