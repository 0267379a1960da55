"""From photos to an avatar (paper, section 3.5).

``request``            what is asked of a fit, by the command line and by Blender's panel
``presets``            how much work a fit is
``types``              what tracking finds in one photo, and its file
``point_rig``          points of the head, such as landmarks, with exact derivatives
``solver``             robust least squares over cameras, shape, expression and pose
``landmark_priors``    how exact landmarks are, how likely expressions and cameras
``landmark_stage``     camera, shape, expression and pose from landmarks
``outline``            where the skin ends in a photo: ears and cheeks
``photo_light``        the light of a photo from the skin's colors; ``white_balance``: its cast
``person_lights``      the lights of all photos of a person, by the colors that they agree on; ``local_light``: what no lamp
                       explains of them; ``fold_light``: shade in narrow folds
``photometric_stage``  the refinement by outline
``track``              photos to tracks; ``pixel_stage``: again by all their pixels, as a quick avatar looks; ``tilt``: heads
                       that lean tilt on their necks
``faces_picture``      the faces of a photo as a picture, to check the choice
``photo_targets``      tracked photos as what the inversion compares with
``objective``          attributes drawn into a photo's camera, and their loss
``code_stage``         stage 1, the codes (eq. 19); ``recoloring``: the photo's colors and light; ``adam``: the descent
``decoder_stage``      stage 2, the decoders (eq. 20); ``locality``, ``surface`` and ``inpainting`` keep and fill in the rest,
                       ``agreement``: which of several photos is believed where; ``even_tint``: which tints are light's;
                       ``creases`` binds folds to the expression, ``grain`` carries seen detail on, ``lids`` are plain
``hair_light``         hair as the studio's light would show it; ``blurring``: planes of pictures
``hair_stage``         a person's hair, for weights without hair; ``hair_view``: what a photo says of it; ``hair_grain``: how
                       strands lie, straight, wavy or coily; ``hair_match``: the groom that photos show; ``hair_shape``: bent
                       to them, ``strays`` left out, and as flat behind (``hidden_hair``); ``hair_trim``: cut and
                       ``hair_texture``: colored by them; ``root_shade``: the skin under it; ``face_hair``: brows, beard
                       (``long_beard``), lashes
``settling``           what the avatar as a session draws it still lacks; ``mouth_colors``: lips and teeth at
                       rest; ``eye_colors``: irises, whites and the line of lashes
``invert``             tracks to an avatar by both stages
``folder``             the work folder: whose state it holds, what is refused before work begins; ``checkpoint``: the tuning's
``batch``              a folder of people, here or on a cluster; ``result``: what a fit becomes in an avatar
``api``                all of it, for the command line and Blender

From `request` to `photometric_stage`, and for `folder`, numpy is enough; the rest needs torch.
"""
