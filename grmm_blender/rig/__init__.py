"""The rig of an avatar: a head mesh with shape keys, an armature, and the properties that drive them.

=====================  =================================================================================
``avatar``             an avatar as a Python object: reads its controls and placement
``custom_properties``  the controls on the head object, as the core's table of controls has them
``identity``           from an avatar's source to its head model and resting shape, with numpy alone
``mesh``               the head mesh: geometry, UV map, vertex groups, shape keys
``materials``          what the mesh looks like where no splats are drawn
``armature``           bones, bone collections, constraints
``drivers``            what drives shape keys and bones: SUM drivers only, so files work with auto-run off
``build``              puts the above together: `build_avatar`
``actions``            curves of an object's action, and many keys at once
``saved_codes``        saved residual codes and the blend between them
``layers``             what adds to named expressions beside their sliders
``components``         what single components of the residual codes do, in words
``weighted_sums``      sums of hundreds of small shape components, quick from frame to frame
``left_rigs``          rigs whose heads were deleted, heads whose rigs were
``live``               what the add-on keeps up to date: residual key, rest joints
=====================  =================================================================================

How a control reaches the mesh (no scripted driver, no add-on needed, except for what ``live`` does):

* Custom properties on the head object are what animators keyframe: one float for each named expression (``jawOpen``),
  arrays ``shape``, ``expression``, ``z_id``, ``z_exp``, and single numbers such as ``residual_strength``.
* Shape key ``shape.k`` = shape[k]; expression key k = expression[k] + its ARKit float. A named expression that is more than
  one component of the head (a mixture, or an ARKit shape on FLAME) has a key of its own with its recipe's sum of offsets;
  so have blinks and closed lips, which go differently far on each person (``grmm_core.head.closing``).
* Joints have four bones with the same rest pose, aligned with the head's axes: ``MCH-jaw`` carries the shift of the joint
  with the person's shape, ``jaw`` is the animator's, ``DEF-jaw`` deforms, and ``DRV-jaw`` receives the rotation that
  expressions give. A Copy Rotation constraint in the mode Add puts DRV's Euler angles on top of the animator's own: the sum is
  linear, as `grmm_core.controls.frame.resolve` wants it, and the animator's channels stay free.
* So a pose control has one place, the bone's rotation; panels show that channel itself and nothing has to be kept in step.

Nothing here imports torch; the model is reached through `session_host`.
"""
