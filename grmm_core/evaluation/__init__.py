"""How good a model is: protocols, figures, tables and pictures.

The map:

``metrics``          errors of one picture: whole frame, inside the mask, by region (``lpips``, ``fid``: with a user's networks)
``regions``          which region of the head each pixel shows
``scene``            a trained model that draws captured views, with parts switched off on request
``samples``          which views of a capture a protocol uses
``person_fit``       a held-out person's codes from one view
``protocols``        the protocols: views in, rows of numbers out
``photo_fits``       real photos fitted as users do, and what the stages of the fitting give (``identity``: by face recognition)
``cleanliness``      wisps, holes, specks and seams of a person seen from all sides
``evenness``         how much light is left in a face that a photo's light was taken out of
``disentanglement``  whether identity and expression are separate, and smooth
``strips``           pictures of codes: random people, interpolations, transfer
``report``           rows to JSON, tables and picture sheets

Uses `model`, `head`, `data`, `training` (losses, perceptual networks) and `fitting`. Called by the command line
(`grmm evaluate`). Everything but `samples`, `report` and `fid` imports torch.
"""

from __future__ import annotations
