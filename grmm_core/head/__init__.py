"""Head models: the open head, the user's FLAME, skinning.

``model``       `HeadModel`, FLAME's format as numpy arrays; needs numpy only
``skinning``    linear blend skinning as pure functions, for numpy and torch
``open_head``   the project's own head and its relation to age, gender, ethnicity and weight
``flame_file``  reading the user's FLAME file without executing it
``torch_head``  batched, differentiable twin for training; imported only where torch is
"""

from __future__ import annotations

from .model import HeadModel
from .open_head import PeopleModel, load_open_head, load_people_model, read_head

__all__ = ["HeadModel", "PeopleModel", "load_open_head", "load_people_model", "read_head"]
