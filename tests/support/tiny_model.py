"""A small model with random weights, for tests of what is built around the model."""

from __future__ import annotations

from pathlib import Path

import numpy as np


def write_tiny_weights(path: Path, seed: int = 5, name: str = "tiny", preset: str = "tiny", head=None, **changes) -> Path:
    """Write random weights of a configuration, on the open head unless told; every part of the network does something."""
    import torch

    from grmm_core.head import load_open_head
    from grmm_core.model.config import PRESETS
    from grmm_core.model.grmm import GRMM
    from grmm_core.model.weights import save_weights
    from grmm_core.model.weights_file import WeightsInfo, head_fingerprint

    torch.manual_seed(seed)
    head = head or load_open_head()
    model = GRMM(head, PRESETS[preset].replace(**changes))
    with torch.no_grad():
        for head_of in (model.mesh_decoder.identity, model.mesh_decoder.expression):
            head_of[-1].weight.normal_(std=0.5)
        if model.decoders.expression is not None:
            model.decoders.expression.maps.normal_(std=0.1)
            model.decoders.expression.gains.weight.normal_(std=0.1)
        if model.refinement is not None:
            model.refinement.exit.weight.normal_(std=0.05)
            model.refinement.exit.bias.normal_(std=0.05)
        if model.decoders.appearance_mean is not None:
            model.decoders.appearance_mean.uniform_(0.2, 0.8)
    rng = np.random.default_rng(seed)
    people = 4
    info = WeightsInfo(
        name=name,
        head_name=head.name,
        head_sha256=head_fingerprint(head),
        config=model.config,
        people=tuple(f"person {i}" for i in range(people)),
        z_id=rng.normal(size=(people, model.z_id_size)).astype(np.float32),
        shapes=rng.normal(size=(people, head.shape_count)).astype(np.float32),
        default_z_id=rng.normal(size=model.z_id_size).astype(np.float32),
        default_shape=np.zeros(head.shape_count, np.float32),
        provenance={"licence": "CC0-1.0"},
    )
    save_weights(path, model, info)
    return path
