"""What an animator sets: names of expressions and joints, and one frame of them. Needs numpy only.

``names``   the 52 ARKit shapes, the aligned expressions, joints
``frame``   `Controls`, how they become quantities of the model, and what `--set` takes
"""
