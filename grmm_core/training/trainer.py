"""The training loop.

    trainer = Trainer(config, head, source, folder)
    trainer.resume()                  # where a checkpoint exists
    trainer.run()
    trainer.save_weights(path)

A step renders `views_per_step` views, averages their gradients, and updates parameters with Adam. Several processes started
by ``torchrun`` share the views of a step and average gradients, so that they do what one process would (`processes`). Metrics
go to ``metrics.jsonl``, sheets to ``preview_*.png``, their curves to ``curves.png``, checkpoints to
``checkpoint.safetensors``, all in the run's folder.

Used by the command line.
"""

from __future__ import annotations

import logging
import math
import os
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor, nn

from ..errors import CancelledError, ConfigError, TrainingError
from ..files.access import make_folder
from ..jobs.progress import ProgressCallback, Reporter
from ..jobs.stages import TRAINING
from ..model.grmm import GRMM
from ..model.weights import save_weights
from ..model.weights_file import WeightsInfo, head_fingerprint
from . import partial
from .cast import Cast
from .checkpoint import load_checkpoint, save_checkpoint, tidy
from .config import TrainConfig, changed_settings
from .initialise import initialise_colors
from .losses import TERMS, psnr, ssim, total_loss, vertex_laplacian, weights_from
from .metrics_log import METRICS, MetricsLog
from .optimise import MovingAverage, parameter_groups, rate_factor
from .perceptual import load_perceptual
from .personal import begin, of_the_weights, person_avatar
from .precision import use_precision
from .processes import add_gradients, anybody, join, mean_terms
from .views import View, ViewSource, choose, shrink
from .warm_start import layout_to_start, warm_start

if TYPE_CHECKING:
    from ..avatar import Avatar, Hair
    from ..head import HeadModel

logger = logging.getLogger(__name__)

CHECKPOINT = "checkpoint.safetensors"
CURVES = "curves.png"
_COLOR_VIEWS = 48
_RANDOM_CODE_INIT = 10_007  # keeps the stream of the codes apart from the model's


class Trainer:
    """One training run.

    Args:
        config: Sizes, schedule, losses.
        head: Head model of the data.
        source: Views.
        folder: Where checkpoints, metrics and previews go; created if needed.
        device: Torch device.
        backend: Rasteriser backend.

    Raises:
        ConfigError, FileAccessError: The configuration or folder cannot be used.
        TrainingError: There is nothing to train on.
    """

    def __init__(
        self, config: TrainConfig, head: HeadModel, source: ViewSource, folder: str | os.PathLike[str],
        device: str = "cpu", backend: str = "auto",
    ) -> None:  # fmt: skip
        if not len(source.training):
            raise TrainingError("The data set has no training views; capture more or change its splits.")
        if config.person or config.partial:
            config = (of_the_weights if config.person else partial.of_the_weights)(config)
        self.config, self.source, self.folder = config, source, Path(folder)
        make_folder(self.folder)
        if config.threads:
            torch.set_num_threads(config.threads)
        self.rank, self.world = join(device)
        if config.views_per_step % self.world:
            raise ConfigError(f"views_per_step {config.views_per_step} must be a multiple of the {self.world} processes.")
        if self.world > 1 and config.minutes:
            raise ConfigError("Several processes cannot follow the clock; set steps, and minutes to 0.")
        if self.world > 1 and config.refresh_every:
            raise ConfigError("Several processes cannot follow a capture; wait until it is complete and leave out --follow.")
        self.log = MetricsLog(self.folder, config.tensorboard)
        torch.manual_seed(config.seed)
        layout = layout_to_start(config.init_from, head, config.model) if config.init_from else None
        self.model = GRMM(head, config.model, layout).to(device)
        use_precision(self.model, config.precision)
        generator = torch.Generator().manual_seed(config.seed + _RANDOM_CODE_INIT)
        codes = torch.randn(len(source.people), config.model.z_id, generator=generator) * config.code_init
        self.codes = nn.Parameter(codes.to(device))  # z_id of each person, [P, Z]
        self.cast = Cast(self.model, self.codes, self._shapes(), backend)
        self.laplacian = vertex_laplacian(torch.from_numpy(head.faces.astype(np.int64)), head.vertex_count).to(device)
        self.loss_weights = weights_from(dict(config.losses))
        self.perceptual = None
        if self.loss_weights.perceptual:
            if not config.perceptual_network:
                raise ConfigError("The perceptual loss needs perceptual_network, such as mobilenet, or a weight of zero.")
            self.perceptual = load_perceptual(config.perceptual_network).to(device)
        self.parameters: dict[str, nn.Parameter] = {"codes": self.codes, **dict(self.model.named_parameters())}
        self.base: dict[str, Tensor] = {}  # what a single person's maps are changes of
        if config.person:
            self.parameters = begin(config, self.model, source.people, self.codes)
            self.base = {name: parameter.detach().clone() for name, parameter in self.parameters.items()}
        elif config.partial:
            self.codes.requires_grad_(False)
            self.parameters = partial.begin(config, self.model, source, self.codes.data)
        self.optimiser = torch.optim.Adam(
            parameter_groups(self.model, self.codes, config), betas=(config.beta1, config.beta2), fused=True
        )
        self.average = MovingAverage(self.parameters.values(), config.ema, config.ema_every) if config.ema else None
        self.differences: list[str] = []  # of a resumed run from the one that wrote the checkpoint, in words
        self.metrics: dict[str, float] = {}  # newest numbers by name
        self.sheet = ""  # file of the newest previews
        self.step_count = 0
        self.seconds = 0.0
        # of one person or a part a run begins above: a resumed one needs the frozen parts too
        self.started = bool(self.base) or config.partial

    @property
    def progress(self) -> float:
        """Share of the schedule that is done, 0..1."""
        done = self.seconds / (60.0 * self.config.minutes) if self.config.minutes else self.step_count / self.config.steps
        return min(1.0, done)

    # --- running ---------------------------------------------------------------------------------------------------

    def run(self, progress: ProgressCallback | None = None, cancelled: Callable[[], bool] | None = None) -> None:
        """Train to the end of the schedule; ends with a checkpoint.

        Args:
            progress: Called after each step, with the newest sheet of previews; `metrics` holds the step's numbers.
            cancelled: Asked after each step; True saves a checkpoint and ends, in all processes where one says so.

        Raises:
            CancelledError: `cancelled` returned True; the checkpoint holds everything done.
            TrainingError: The loss is not finite. The last checkpoint is kept as it was.
            FileAccessError: Disk full or not writable.
        """
        try:
            self._run(Reporter(TRAINING, progress, cancelled))
        finally:
            self.log.close()

    def _run(self, report: Reporter) -> None:
        report("prepare", 0.0)
        self.start()
        c = self.config
        while self.progress < 1.0:
            metrics = self.step()
            self.metrics.update(metrics)
            n = self.step_count
            report("steps", self.progress, f"step {n} loss {metrics['loss']:.4f}", self.sheet)
            ends = self.progress >= 1.0
            if c.refresh_every and n % c.refresh_every == 0:
                self.refresh()
            if c.evaluate_every and (n % c.evaluate_every == 0 or ends):
                metrics |= self.evaluate(c.evaluate_views)
                logger.info("step %d: %s", n, {k: round(v, 4) for k, v in metrics.items()})
            if self.rank == 0:
                self.log.write(n, metrics)
            if self.rank == 0 and c.preview_every and (n % c.preview_every == 0 or ends):
                self._preview()
            stopped = anybody(report.wants_to_stop, self.model.device)
            if self.rank == 0 and ((c.checkpoint_every and n % c.checkpoint_every == 0) or ends or stopped):
                self.save()
            if stopped and not ends:
                raise CancelledError(f"The training was stopped after step {n}; continue it with --resume.")

    def refresh(self) -> None:
        """Take up what was added to the data since, where the source can tell."""
        refresh = getattr(self.source, "refresh", None)
        if refresh is not None:
            refresh()
            self.cast.shapes = self._shapes()

    def _shapes(self) -> Tensor:
        return torch.as_tensor(self.source.shapes, dtype=torch.float32, device=self.model.device)

    def start(self) -> None:
        """Prepare what depends on the data, once, before the first step of a new run."""
        if not self.started and self.step_count == 0:
            if self.config.init_from:
                warm_start(self.config.init_from, self.model, self.source.people, self.codes)
            else:
                initialise_colors(self.model, self.source, _COLOR_VIEWS, self.config.seed)
            if self.average:
                self.average = MovingAverage(self.parameters.values(), self.config.ema, self.config.ema_every)
        self.started = True

    def step(self) -> dict[str, float]:
        """Do one optimiser step and return its numbers. Raises `TrainingError` where the loss is not finite."""
        begin = time.perf_counter()
        c, n, progress = self.config, self.step_count, self.progress
        refined = self.model.refinement is not None and progress >= c.refine_from
        self.optimiser.zero_grad(set_to_none=True)
        share = c.views_per_step // self.world
        rows: list[dict[str, Tensor]] = []
        for place in range(self.rank * share, (self.rank + 1) * share):
            view, background = choose(c, self.source, n, place, progress)
            rendering, target = self.cast.draw(view, background, refined), self.cast.target(view, background)
            loss, terms = total_loss(rendering, target, self.laplacian, self.loss_weights, refined, self.perceptual)
            value = float(loss.detach())
            if not np.isfinite(value):
                raise TrainingError(f"The loss is {value} at step {n} ({view.name}); {self._way_out()}.")
            (loss / c.views_per_step).backward()
            rows.append({"loss": loss.detach(), **terms})
        add_gradients(self.parameters.values())
        norm = torch.nn.utils.clip_grad_norm_(self.parameters.values(), c.clip_norm or math.inf)  # infinity clips nothing
        if not bool(torch.isfinite(norm)):
            raise TrainingError(f"A gradient is not finite at step {n}; {self._way_out()}.")
        factor = rate_factor(c, n, progress)
        for group in self.optimiser.param_groups:
            group["lr"] = group["peak"] * factor
        self.optimiser.step()
        self.step_count += 1
        if self.average:
            self.average.update(self.step_count)
        self.seconds += time.perf_counter() - begin
        views = [dict(zip(row, torch.stack([*row.values()]).tolist(), strict=True)) for row in rows]
        means = mean_terms(views, ("loss", *TERMS), self.model.device)
        numbers = {"step": float(self.step_count), "loss": means.pop("loss"), "gradient_norm": float(norm), "rate": factor}
        numbers |= {"seconds": self.seconds, "progress": self.progress}
        return numbers | means

    def _way_out(self) -> str:
        """What to do about numbers that are not finite."""
        kept = (self.folder / CHECKPOINT).exists()
        return "lower the learning rates and " + ("continue from the last checkpoint with --resume" if kept else "start again")

    # --- judging ---------------------------------------------------------------------------------------------------

    @torch.no_grad()
    def evaluate(self, count: int) -> dict[str, float]:
        """PSNR and SSIM on held-out views with the averaged weights, over black: whole picture and inside the mask.

        Args:
            count: Views, spread over the validation set; all where it has fewer.
        """
        held_out = self.source.validation
        chosen = np.unique(held_out[np.linspace(0, len(held_out) - 1, count).astype(int)]) if len(held_out) else held_out
        refine = self.model.refinement is not None
        rows: list[dict[str, float]] = []
        with self.averaged():
            for index in chosen:
                view = self._sized(self.source.load(int(index)))
                rendering = self.cast.draw(view, None, refine)
                target = self.cast.target(view, np.zeros(3))
                image, raw = rendering.image.clamp(0, 1), rendering.raw.clamp(0, 1)
                row = {"psnr": psnr(image, target.image), "psnr_mask": psnr(image, target.image, target.mask)}
                row |= {"psnr_raw": psnr(raw, target.image), "ssim": float(ssim(image, target.image))}
                if view.split:
                    row[f"psnr_{view.split}"] = row["psnr"]
                rows.append(row)
        names = sorted({name for row in rows for name in row})
        return {f"val_{name}": float(np.mean([row[name] for row in rows if name in row])) for name in names}

    def averaged(self) -> AbstractContextManager[None]:
        """Context in which the model holds the moving average of its parameters."""
        return self.average.swapped() if self.average else nullcontext()

    def _sized(self, view: View) -> View:
        return shrink(view, self.config.image_size) if self.config.image_size else view

    def _preview(self) -> None:
        from .metric_plots import read_metrics, write_curves
        from .preview import VALIDATION_ROWS, write_preview

        numbers = self.source.validation if len(self.source.validation) else self.source.training
        picks = numbers[np.linspace(0, len(numbers) - 1, VALIDATION_ROWS + 2).astype(int)[1:-1]]
        views = [self._sized(self.source.load(int(index))) for index in picks]
        path = self.folder / f"preview_{self.step_count:06d}.png"
        with self.averaged():
            write_preview(self.cast, views, path)
        self.sheet = str(path)
        write_curves([read_metrics(self.log.path)], self.folder / CURVES)

    # --- files -----------------------------------------------------------------------------------------------------

    def save(self) -> None:
        """Write the checkpoint. Raises `FileAccessError`; an earlier checkpoint is then intact."""
        averages = dict(zip(self.parameters, self.average.values, strict=True)) if self.average else {}
        state = {"step": self.step_count, "seconds": self.seconds, "people": self.source.people}
        state |= {"views": len(self.source.training), "config": self.config.to_json()}
        save_checkpoint(self.folder / CHECKPOINT, self.parameters, self.optimiser, averages, state)

    def resume(self) -> bool:
        """Continue from the folder's checkpoint; `differences` then says in what this run is not the one that wrote it.

        Returns:
            False where there is no checkpoint.

        Raises:
            FileFormatError: It is damaged.
            ConfigError: It is of other people, or of a model of other sizes.
        """
        path = self.folder / CHECKPOINT
        if not path.exists():
            return False
        averages = dict(zip(self.parameters, self.average.values, strict=True)) if self.average else {}
        state = load_checkpoint(path, self.parameters, self.optimiser, averages, self._check)
        self.differences = _differences(state, self.config, len(self.source.training))
        self.step_count, self.seconds, self.started = int(state["step"]), float(state["seconds"]), True
        if self.rank == 0:
            tidy(self.folder, METRICS, self.step_count)
        return True

    def _check(self, state: dict[str, Any]) -> None:
        """Refuse a checkpoint that is not of this model and these people. Raises `ConfigError`."""
        if tuple(state.get("people", ())) != tuple(self.source.people):
            raise ConfigError("The checkpoint is of other people than this data set has; use its data or another folder.")
        sizes = "; ".join(changed_settings(state.get("config"), self.config, ("model",)))
        if sizes:
            raise ConfigError(f"This is not the model of the checkpoint ({sizes}); use its configuration or another folder.")

    def save_weights(self, path: str | os.PathLike[str], provenance: dict[str, Any], default_person: int | None = None) -> None:
        """Write the averaged weights.

        Args:
            path: Target file.
            provenance: JSON values for the model card.
            default_person: Person who becomes the default avatar; the mean of all when None.
        """
        if self.config.partial:
            with self.averaged():
                return save_weights(path, self.model, partial.continued(self.config, self.model.head_model, provenance))
        seen = np.unique(self.source.subjects[self.source.training])  # those of a running capture may still be missing
        with self.averaged():
            codes = self.codes.detach().cpu().numpy()[seen].copy()
            shapes = self.source.shapes[seen]
            identity = codes if self.config.model.residuals else shapes
            pick = slice(None) if default_person is None else seen == default_person
            head = self.model.head_model
            info = WeightsInfo(
                self.config.name, head.name, head_fingerprint(head), self.config.model,
                people=tuple(self.source.people[i] for i in seen), z_id=identity, shapes=shapes,
                default_z_id=identity[pick].mean(0), default_shape=shapes[pick].mean(0), provenance=provenance,
            )  # fmt: skip
            save_weights(path, self.model, info)

    def person_avatar(self, name: str, licence: str = "", hair: Hair | None = None) -> Avatar:
        """What a run for one person has trained, as an avatar without pictures.

        Args:
            name: Display name.
            licence: What may be done with the avatar.
            hair: What the person wears.

        Raises:
            ConfigError: The run is for many people.
            FileAccessError, FileFormatError: The weights that the run began with are gone.
        """
        if not self.base:
            raise ConfigError("This run is for many people; set person=NAME to make an avatar of one.")
        with self.averaged():
            with torch.no_grad():
                changes = {key: value - self.base[key] for key, value in self.parameters.items()}
            return person_avatar(self.config.init_from, self.model, self.cast.person(0), changes, name, licence, hair)


def _differences(state: dict[str, Any], config: TrainConfig, views: int) -> list[str]:
    known = state.get("views", views)
    more = [f"{views} training views instead of {known}, in another order"] if known != views else []
    return changed_settings(state.get("config"), config, ("training", "losses")) + more
