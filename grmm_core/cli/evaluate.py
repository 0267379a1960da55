"""`grmm evaluate`: how good trained weights are on captured data."""

from __future__ import annotations

import argparse
import importlib.util
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..avatar import EXTENSION, load_avatar
from ..avatar.library import library_file
from ..errors import ConfigError
from ..files.access import atomic_write_bytes, make_folder
from ..jobs.cluster import Cluster, run_pieces
from ..jobs.progress import Reporter, Share, within
from ..jobs.stages import EVALUATION, PIECES, JobStages
from .common import DEVICES, add_cluster, add_events, cluster_of, count, make_absolute, positive_int
from .console import plain

if TYPE_CHECKING:
    from ..avatar import Avatar
    from ..evaluation.protocols import Evaluation, Result
    from ..evaluation.scene import Scene

PROTOCOLS = ("reconstruction", "novel-view", "expression", "person", "monocular", "transfer")
CODES, ALL, MONOCULAR = "codes", "all", "monocular"
SHARE_FITS = ("person", "transfer")  # measured by one process of a cluster, which fits each person once
METHODS = ("codes", "fast", "standard", "high")
DEFAULT_LIMIT = 60
TRANSFER_PEOPLE = 6  # in a sheet
RESULT, TABLE = "evaluation.json", "evaluation.md"


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "evaluate",
        help="measure trained weights on captured data",
        description="Measure trained weights: held-out views, expressions and people; with and without refinement and "
        "residuals; by region. Writes JSON, a table and pictures.",
    )
    parser.add_argument(
        "weights", metavar="WEIGHTS",
        help="weights file, name of weights that come with the package, or an avatar of somebody whom they were trained on",
    )  # fmt: skip
    parser.add_argument("--data", nargs="+", metavar="DIR", required=True, help="data sets with held-out views and people")
    parser.add_argument("--head", metavar="FILE", help="your FLAME file, for data and weights on FLAME")
    parser.add_argument(
        "--protocol", nargs="+", choices=(*PROTOCOLS, CODES, ALL), default=[ALL], metavar="NAME",
        help=f"{', '.join(PROTOCOLS)}, {CODES} or {ALL} (default: all)",
    )  # fmt: skip
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, help="folder for JSON, table and pictures")
    parser.add_argument(
        "--limit", type=count, default=DEFAULT_LIMIT, metavar="N", help="views of a protocol, 0 for all (default: %(default)s)"
    )
    parser.add_argument("--people", type=count, default=0, metavar="N", help="held-out people to fit (default: all)")
    parser.add_argument("--size", type=positive_int, metavar="PX", help="reduce pictures to this longer side")
    parser.add_argument(
        "--fit", choices=METHODS, default="fast",
        help="how people are fitted from one view: by the presets of grmm fit, or by their codes alone (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument("--fid", metavar="FILE", help="also FID, with this Inception network (TorchScript)")
    parser.add_argument("--ablation", metavar="WEIGHTS", help="second weights, trained without residuals, on the same views")
    parser.add_argument("--no-ablations", action="store_true", help="do not draw again with residual codes switched off")
    parser.add_argument(
        "--with-hair", action="store_true", help="draw people in the hair that their capture recorded, on pictures with hair"
    )
    parser.add_argument("--no-regions", action="store_true", help="do not measure by region of the head")
    parser.add_argument(
        "--perceptual", default="auto", metavar="NETWORK",
        help="auto, none, mobilenet, mobilenet:FILE or vgg19:FILE (default: MobileNetV2 where its package is installed)",
    )  # fmt: skip
    parser.add_argument("--lpips", metavar="FILE", help="also LPIPS, with these weights (VGG16 and linear layers)")
    parser.add_argument(
        "--identity", metavar="FILE", help="of photos also likeness by this face-recognition network (TorchScript), or dlib"
    )
    parser.add_argument("--seed", type=count, default=0, help="of the choice of views (default: %(default)s)")
    parser.add_argument("--device", choices=DEVICES, default="auto", help="where the model runs (default: %(default)s)")
    parser.add_argument("--threads", type=positive_int, metavar="N", help="CPU threads (default: all)")
    add_cluster(parser)
    add_events(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Evaluate, write the files, and return the figures without those of single views."""
    from ..data.readers import is_dataset

    if args.cluster:
        make_absolute(args, "weights", "data", "head", "output", "ablation", "lpips", "fid", "identity")
    stages = EVALUATION.only(_protocols(args.protocol))
    with cluster_of(args) as cluster:
        args.threads = args.threads or (cluster.threads if cluster is not None else None)
        if MONOCULAR in args.protocol and not any(is_dataset(folder) for folder in args.data):
            return _photos(args, cluster)
        evaluation = _open(args)
        if args.output is not None:
            make_folder(args.output)
        facts, summaries = _facts(args, evaluation.scene, evaluation.ablation), {}
        for name, found in _measured(evaluation, args, stages, cluster):
            if "skipped" in found:  # the data holds no views for it
                facts.setdefault("skipped", {})[name] = found["skipped"]
                args.console.message(f"{name}: skipped. {found['skipped']}")
                continue
            if name == CODES:
                facts[CODES] = found
            else:
                summaries[name] = found
                args.console.message(f"{name}: {found['views']} views, {found['refined']['psnr_mask']:.2f} dB in the mask")
                summaries = {stage.name: summaries[stage.name] for stage in stages.stages if stage.name in summaries}
            if args.output is not None:  # after each protocol: what is measured is not lost when a later one fails
                _write(args.output, {**facts, "protocols": summaries}, _text(facts, summaries))
    args.console.line(_text(facts, summaries))
    if args.output is not None:
        args.console.line(f"Wrote {args.output / RESULT}, {TABLE} and pictures.")
    short = {name: {k: v for k, v in values.items() if k != "rows"} for name, values in summaries.items()}
    return {**facts, "protocols": short}


def _open(args: argparse.Namespace) -> Evaluation:
    """Model, data and settings."""
    import torch

    from ..data.readers import open_dataset
    from ..evaluation.fid import InceptionFeatures
    from ..evaluation.protocols import Evaluation, Settings
    from ..evaluation.scene import Scene
    from ..head import load_flame
    from ..model.weights_file import resolve_weights
    from .train import _device

    if args.threads:
        torch.set_num_threads(args.threads)
    device = _device(args.device)
    settings = Settings(
        args.limit, args.people, args.size or 0, args.fit, not args.no_ablations, not args.no_regions,
        _distances(args, device), args.with_hair, args.seed, InceptionFeatures(args.fid, device) if args.fid else None,
    )  # fmt: skip
    head = load_flame(args.head) if args.head else None
    datasets = [open_dataset(folder, head) for folder in args.data]
    avatar = _avatar(args.weights)
    weights = args.weights if avatar is None else avatar.weights.name
    scene = Scene(resolve_weights(weights), device, head=head, avatar=avatar)
    ablation = Scene(resolve_weights(args.ablation), device, head=head) if args.ablation else None
    return Evaluation(scene, datasets, settings, ablation)


def _measured(
    evaluation: Evaluation, args: argparse.Namespace, stages: JobStages, cluster: Cluster | None
) -> Iterator[tuple[str, dict[str, Any]]]:  # fmt: skip
    """Every protocol's name and what it gave, here in the order of the stages, on a cluster as they are done."""
    names = [stage.name for stage in stages.stages]
    if cluster is None:
        with args.console.progress(stages) as show:
            reporter = Reporter(stages, show)
            for name in names:
                yield name, _measure(evaluation, args, name, reporter.part(name))
        return
    groups = [[name for name in names if name in SHARE_FITS], *([name] for name in names if name not in SHARE_FITS)]
    pieces = [(_portable(args), group) for group in groups if group]
    with args.console.progress(PIECES) as show:
        for _, found in cluster.run(measure_protocols, pieces, Reporter(PIECES, show).part("pieces")):
            yield from found.items()


def measure_protocols(piece: tuple[dict[str, Any], list[str]], report: Share) -> dict[str, dict[str, Any]]:
    """Measure protocols on a worker, from the command's arguments."""
    args = argparse.Namespace(**piece[0])
    evaluation = _open(args)
    return {name: _measure(evaluation, args, name, report) for name in piece[1]}


def _portable(args: argparse.Namespace) -> dict[str, Any]:
    """The arguments as they travel to other processes."""
    return {name: value for name, value in vars(args).items() if name != "console"}


def _measure(evaluation: Evaluation, args: argparse.Namespace, name: str, share: Share) -> dict[str, Any]:
    """Figures of one protocol, whose pictures are written; or why it is skipped."""
    from ..evaluation import report

    if name == CODES:
        return _codes(evaluation.scene, args.output, share)
    try:
        result = evaluation.run(name, share)
    except ConfigError as error:
        if ALL not in args.protocol:
            raise
        return {"skipped": str(error)}
    if args.output is not None:
        _write_pictures(evaluation, result, args.output)
    return report.summary(result)


def _avatar(source: str) -> Avatar | None:
    """The avatar that is to be judged in the place of weights, or None."""
    path = library_file(source) or (source if source.endswith(EXTENSION) else None)
    return None if path is None else load_avatar(path)


def _photos(args: argparse.Namespace, cluster: Cluster | None) -> dict[str, Any]:
    """The monocular protocol on folders of real photos: figures in the photos' views, avatars and sheets."""
    from ..evaluation.photo_fits import photos_result, photos_table
    from ..fitting.batch import photos_in

    if args.output is None:
        raise ConfigError("Photos are judged by looking at their sheets; give a folder for them with --output.")
    photos: dict[str, list[Path]] = {}
    for folder in args.data:
        photos[Path(folder).name] = photos_in(folder)
        if not photos[Path(folder).name]:
            raise ConfigError(f"{folder} holds neither a data set nor photos; choose another folder.")
        make_folder(args.output if len(args.data) == 1 else args.output / Path(folder).name)
    places = [(name, photo) for name, paths in photos.items() for photo in paths]
    pieces = [(_portable(args), photo, args.output if len(photos) == 1 else args.output / name) for name, photo in places]
    rows: dict[str, dict[str, dict[str, Any]]] = {name: {path.name: {} for path in paths} for name, paths in photos.items()}
    stages = EVALUATION.only((MONOCULAR,))
    with args.console.progress(stages) as show:
        for number, row in run_pieces(measure_photo, pieces, Reporter(stages, show).part(MONOCULAR), cluster):
            name, photo = places[number]
            rows[name][photo.name] = row
    results = {name: photos_result(found, _preset(args)) for name, found in rows.items()}
    text = "\n".join(photos_table(result) for result in results.values())
    _write(args.output, {"weights": args.weights, "monocular": results}, text)
    args.console.line(text)
    return results


def measure_photo(piece: tuple[dict[str, Any], Path, Path], report: Share) -> dict[str, Any]:
    """Fit and measure one photo from the command's arguments, here or on a worker."""
    from ..evaluation.identity import load_identity
    from ..evaluation.photo_fits import evaluate_photo
    from ..evaluation.scene import Scene
    from ..model.weights_file import resolve_weights
    from .train import _device

    args, device = argparse.Namespace(**piece[0]), _device(piece[0]["device"])
    return evaluate_photo(
        piece[1], Scene(resolve_weights(args.weights), device), args.weights, piece[2], _preset(args), device=device,
        threads=args.threads or 0, distances=_distances(args, device),
        identity=load_identity(args.identity) if args.identity else None, report=report,
    )  # fmt: skip


def _preset(args: argparse.Namespace) -> str:
    return str(args.fit if args.fit != CODES else "fast")


def _protocols(names: list[str]) -> list[str]:
    return [*PROTOCOLS, CODES] if ALL in names else list(dict.fromkeys(names))


def _facts(args: argparse.Namespace, scene: Scene, ablation: Scene | None) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "weights": scene.info.name, "weights sha256": scene.info.sha256, "data": [Path(d).name for d in args.data],
        "limit": args.limit, "fit": args.fit, "seed": args.seed, "background": "black",
    }  # fmt: skip
    if args.size:
        facts["size"] = args.size
    if ablation is not None:
        kind = "trained with residuals, other weights" if ablation.residuals else "trained without residuals (eq. 21)"
        facts["second model"] = {"weights": ablation.info.name, "sha256": ablation.info.sha256, "kind": kind}
    return facts


def _text(facts: dict[str, Any], summaries: dict[str, Any]) -> str:
    from ..evaluation import report

    text = report.table(summaries) if summaries else ""
    codes = facts.get(CODES)
    if codes:
        text += report.codes_table(codes)
    return text


def _codes(scene: Scene, output: Path | None, report: Share) -> dict[str, Any]:
    from ..evaluation.disentanglement import separation
    from ..evaluation.strips import write_pictures

    figures = separation(scene, within(report, 0.0, 0.5))
    if output is not None:
        figures |= write_pictures(scene, output, report=within(report, 0.5, 1.0))
    return figures


def _write_pictures(evaluation: Evaluation, result: Result, folder: Path) -> None:
    from ..evaluation import report
    from ..evaluation.strips import transfer_sheet
    from ..pictures.images import write_png

    rows = []
    for row in report.picked(result.rows):
        truth, image, raw = (picture.astype("float32") / 255.0 for picture in row.pictures)
        rows.append([truth, image, raw, report.error_map(image, truth)])
    write_png(folder / f"{result.name}.png", report.sheet(rows))
    if result.name == "transfer":
        people = list({row.person.name: row.person for row in result.rows}.values())
        write_png(folder / "transfer_expressions.png", report.sheet(transfer_sheet(evaluation.scene, people[:TRANSFER_PEOPLE])))


def _distances(args: argparse.Namespace, device: str) -> dict[str, Any]:
    from ..training.perceptual import MOBILENET_PACKAGE, load_perceptual

    source = args.perceptual
    if source == "auto":
        source = "mobilenet" if importlib.util.find_spec(MOBILENET_PACKAGE) is not None else "none"
    distances: dict[str, Any] = {}
    if source != "none":
        network = load_perceptual(source).to(device)
        distances[network.name] = network
    if args.lpips:
        from ..evaluation.lpips import load_lpips

        distances["LPIPS (VGG)"] = load_lpips(args.lpips).to(device)
    return distances


def _write(folder: Path, values: dict[str, Any], text: str) -> None:
    atomic_write_bytes(folder / RESULT, (json.dumps(plain(values), indent=1, ensure_ascii=False) + "\n").encode())
    atomic_write_bytes(folder / TABLE, text.encode())
