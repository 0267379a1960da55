"""Training of the model, eq. 15-18.

The map:

``config``        `TrainConfig`, read from TOML (numpy-free)
``losses``        every term of the objective as a pure function; also used by the fitting (``blur``: the window of SSIM)
``perceptual``    features of a classification network, for eq. 16
``views``         what a training view is, and the reproducible choice of views, crops and backgrounds
``capture``       capture data sets as training views
``cast``          the people of a run and the model that draws them
``initialise``    mean colors from the pictures
``warm_start``    networks of an earlier run, for other people
``partial``       what expressions change alone, or what lies in some regions, on top of weights
``personal``      one person's own maps alone (``captured_hair``: the strands of that person)
``processes``     several processes that train one model
``optimise``      parameter groups, schedule, moving average
``precision``     bfloat16 convolutions
``checkpoint``    whole-or-nothing checkpoints as tensor files
``trainer``       `Trainer`: the loop
``preview``       picture sheets
``metrics_log``   the numbers of every step, as lines of JSON and for TensorBoard
``metric_plots``  the logged numbers as a picture

Uses `model`, `splat`, `data`. Called by the command line (`grmm train`). Everything but `config` imports torch.
"""

from __future__ import annotations
