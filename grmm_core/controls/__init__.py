"""What an animator sets: expressions, joints, coefficients, sliders; one frame of them. Needs numpy only.

``names``    the 52 ARKit shapes, the aligned expressions, recipes, joints
``control``  what is known of one control
``table``    all controls, and `Controls`, one frame of them: the one place to add a slider
``handles``  points of the face that are dragged, and what each direction does
``frame``    how a frame becomes quantities of the model; what `--set` takes
"""
