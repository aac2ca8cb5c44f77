"""`inspector run`: a method over a dataset, into a run folder."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, make_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Union

from rich.console import Console
from tyro.conf import OmitSubcommandPrefixes, Positional, Suppress, arg, subcommand

from inspector.commands.work import Work, crew, prepare
from inspector.methods import METHODS, Method
from pipeline.exceptions import InputError, MissingFileError, UnknownIdError

if TYPE_CHECKING:
    from pipeline.scene import Target


@dataclass(frozen=True)
class RunOptions:
    """What all methods have in common."""

    dataset: Positional[Path]
    """Folder of a BOP dataset."""
    out: Path
    """Folder of the run; running again goes on where it stopped."""
    split: str | None = None
    """Folder of the split, such as test_primesense; by default the official test split."""
    targets: Path | None = None
    """List of what to look for, such as test_targets_bop19.json; by default the dataset's own."""
    scenes: tuple[int, ...] = ()
    """Only these scenes."""
    images: tuple[int, ...] = ()
    """Only these images of the scenes."""
    record: bool = True
    """Record what the method sees of each image, for the inspector."""
    workers: int | None = None
    """Processes that work at once; by default as many as there are cores, where it pays."""
    scheduler: str | None = None
    """Address of a Dask scheduler whose workers are taken instead, such as tcp://10.0.0.1:8786; they need this program,
    the dataset and the run's folder at the same paths."""


def _with_settings(settings: type) -> type:
    """The options of a method's subcommand: its own settings beside those that all methods have."""
    own = [("method", Annotated[settings, arg(name="")])]
    made = make_dataclass(f"Run{settings.__name__}", own, bases=(RunOptions,), frozen=True, kw_only=True)
    made.__doc__ = settings.__doc__
    return made


_BY_METHOD = {name: _with_settings(method.settings) for name, method in METHODS.items()}
_SUBCOMMANDS = [Annotated[options, subcommand(name)] for name, options in _BY_METHOD.items()]
_ANY = Union[(*_SUBCOMMANDS, Annotated[None, Suppress])]  # tyro makes subcommands of two types at least


@dataclass(frozen=True)
class RunConfig:
    """Run a method over a dataset, into a run folder with its estimates and recordings."""

    options: Annotated[_ANY, arg(name=""), OmitSubcommandPrefixes]  # type: ignore[valid-type]
    """Of the method chosen."""


def run(config: RunConfig, console: Console | None = None) -> int:
    """Run the method and return the exit code: 1 if an image failed, 130 if interrupted. InputError is left to the caller."""
    from pipeline.bop.dataset import open_dataset
    from pipeline.bop.evaluation.chosen_targets import chosen_targets
    from pipeline.run import Run

    options: Any = config.options
    name = next(name for name, kind in _BY_METHOD.items() if isinstance(options, kind))
    method, console = METHODS[name], console or Console()
    dataset = open_dataset(options.dataset, options.split)
    settings = _for_objects(_checked(options.method, method), chosen_targets(dataset, options.targets))
    targets = _of_objects(chosen_targets(dataset, options.targets, options.scenes, options.images), settings)
    what = {"dataset": dataset, "method": name, "config": asdict(settings), "seed": getattr(settings, "seed", 0)}
    Run.check(options.out, **what)
    with crew(options.workers, options.scheduler) as by:
        if not prepare(method, settings, dataset, by, console, name):
            return 130
        with Run.create(options.out, **what) as made:
            return Work(name, method.estimator(settings, dataset), dataset, targets, options.record).into(
                made, by, console
            )


def _checked(settings: Any, method: Method) -> Any:
    """Settings with whole paths: workers may be elsewhere, and a run that goes on may be begun from another folder.

    Raises MissingFileError for a path where nothing is, before there is a run with it.
    """
    paths = {name: value.absolute() for name, value in vars(settings).items() if isinstance(value, Path)}
    for name, path in paths.items():
        if name not in method.outputs and not path.exists():
            raise MissingFileError(f"{path}: no such file; correct --{name.replace('_', '-')}")
    return replace(settings, **paths)


def _for_objects(settings: Any, targets: "Sequence[Target]") -> Any:
    """Settings with the objects of all targets, where they have `objects` and none are named.

    They do not depend on the scenes and images that are chosen, so that these can be taken one after the other.
    Raises UnknownIdError for an object that no target has.
    """
    named = getattr(settings, "objects", None)
    if named is None:
        return settings
    known = {target.obj_id for target in targets}
    for obj_id in named:
        if obj_id not in known:
            raise UnknownIdError("object", obj_id, "the targets", known)
    return replace(settings, objects=tuple(sorted(set(named) or known)))


def _of_objects(targets: "list[Target]", settings: Any) -> "list[Target]":
    """Targets of the settings' objects. Raises InputError if there are none."""
    named = getattr(settings, "objects", None)
    if named is None:
        return targets
    chosen = [target for target in targets if target.obj_id in named]
    if not chosen:
        objects = ", ".join(map(str, named))
        raise InputError(f"these images have no targets of the objects {objects}; correct --objects, or leave it out")
    return chosen
