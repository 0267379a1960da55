"""Light: lamps and surroundings of a scene, and what they make of colors that were learned under the studio's even rig.

``lamps``         sun, point, spot and area lights in metres, watts and linear colors, as Blender means them
``surroundings``  a world: its spherical harmonics, and its strongest spots taken out as suns
``transfer``      how much of the light from everywhere reaches each vertex of a head that shadows itself
``bounce``        light that skin throws on skin
``shadows``       which part of each lamp a point sees, by depth maps of meshes
``texel_shadows`` the same for the texels of a head: fewer looks at wide lamps, more where texels are long
``materials``     what skin, lips, eyes and teeth do with light: lobes, wetness, scattering, by texel
``lobes``         what surfaces mirror
``skin_relief``   pores and furrows in highlights and close-ups; ``skin_relief_kernel`` again, compiled
``cornea``        the bulge of eyes that glints stand on, and the studio's catchlight
``eye_shade``     whites of eyes, and the shade of lids on them
``mouth_shade``   how dark a mouth is inside; ``lip_tone`` how dark lips are; ``tones`` all three
``shading``       irradiance relative to the rig, and highlights, at each Gaussian
``hair_shading``  the same for strands
``shadow_kernels`` shadow maps again, compiled; ``light_kernels`` shading and relighting;
                  ``skin_light_kernel`` skin in blocks; ``strand_light_kernel`` strands
``resting``       what light does on a head at rest, made once for a person; ``posture`` how a posed one lies beside it
``expressed``     what of the rig's light the colors of an expression hold
``turning``       what a turn of the neck makes of the studio's light
``rough``         all of it at a glance, for viewports and painted meshes
``mesh_light``    light read from the mesh at each pixel; ``mesh_light_kernels`` again, compiled
``relight``       both applied to a picture in linear light
``parse``         lights in words, for the command line

Learned colors stay what they are: skin times the rig (`lamps.STUDIO`). A picture in another light is
lit = linear(picture) * ratio + highlights, where both are splatted like colors: the refinement network still sees what it
was trained on. Ramamoorthi and Hanrahan 2001 (irradiance as nine numbers), Sloan et al. 2002 (transfer), Walter et al. 2007
(GGX). What depends on a light's color or strength, or on flat colors, is one text for numpy and torch, and differentiable.
"""
